"""Describe a table of texts once, for the terminal, a page, a notebook, a Markdown page or a CSV file."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import ClassVar

MAX_CELL_CHARACTERS = 24  # of numbers and names, which stay in one line; longer text is wrapped


@dataclass(frozen=True)
class Table:
    """A table of texts.

    Attributes
    ----------
    headings
        Headings of the columns.
    rows
        Cells, as many in each row as there are headings.
    title
        Title above the table on a terminal.
    caption
        Caption below the table on a terminal.
    left
        The columns that are aligned left; the others, which contain numbers, are aligned right.
    """

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    caption: str = ""
    left: tuple[int, ...] = (0,)
    kind: ClassVar[str] = "table"  # as a part of a page

    @classmethod
    def from_columns(
        cls, title: str, columns: Mapping[str, tuple[Sequence[float | None], int]], max_rows: int, *, keep_last: bool = False
    ) -> Table:
        """Return a table of numbers, thinned out evenly where there are many.

        Parameters
        ----------
        title
            Title of the table.
        columns
            Values by heading, each with the number of significant digits.
        max_rows
            Maximum number of rows.
        keep_last
            Whether thinning starts from the last row, which is then kept in place of the first.
        """
        rows = list(zip(*(values for values, _ in columns.values()), strict=True))
        # -(-a // b): a / b rounded up
        step = max(-(-len(rows) // max_rows), 1)
        shown = rows[::-1][::step][::-1] if keep_last else rows[::step]
        digits = [count for _, count in columns.values()]
        cells = [[format_number(value, count) for value, count in zip(row, digits, strict=True)] for row in shown]
        return cls(tuple(columns), cells, title, left=())

    def is_wordy(self, column: int) -> bool:
        """Return whether a column contains sentences, which are wrapped; numbers and names are not."""
        return any(len(row[column]) > MAX_CELL_CHARACTERS for row in self.rows)

    def to_html(self) -> str:
        """Return headings and rows as HTML; the class ``words`` marks columns of sentences."""
        classes = [' class="words"' if self.is_wordy(column) else "" for column in range(len(self.headings))]

        def join(tag: str, cells: Sequence[str]) -> str:
            """Return a row of cells in HTML; an empty heading is no heading, which screen readers would announce."""
            tags = [tag if cell else "td" for cell in cells]
            rows = zip(tags, classes, cells, strict=True)
            return "".join(f"<{name}{kind}>{escape(cell)}</{name}>" for name, kind, cell in rows)

        body = "\n".join(f"<tr>{join('td', row)}</tr>" for row in self.rows)
        return f"<table><thead><tr>{join('th', self.headings)}</tr></thead>\n<tbody>{body}</tbody></table>"

    def to_markdown(self) -> str:
        """Return headings and rows as a Markdown table."""
        rule = ["---"] * len(self.headings)
        return "".join(
            f"| {' | '.join(escape(cell).replace('|', '&#124;') for cell in row)} |\n"
            for row in (self.headings, rule, *self.rows)
        )

    def to_csv(self) -> str:
        """Return headings and rows as comma-separated values."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows((self.headings, *self.rows))
        return text.getvalue()


def format_number(value: float | None, digits: int = 4) -> str:
    """Format a number to ``digits`` significant digits; a dash for None and for values that are not finite."""
    return "-" if value is None or not math.isfinite(value) else f"{value:.{digits}g}"
