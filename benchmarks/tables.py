"""Tables of measured values: printed for people, kept raw for ``--json``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from rich.console import Console
from rich.table import Table as Printed

FORMATS: dict[str, Callable[[Any], str]] = {
    "": str,
    "ms": lambda seconds: f"{seconds * 1e3:.3g}" if seconds < 1 else f"{seconds * 1e3:.0f}",
    "s": lambda seconds: f"{seconds:.3g}",
    "error": lambda error: f"{error:.1e}",
    "times": lambda factor: f"{factor:.3g} x",
    "count": lambda number: f"{number:,}".replace(",", " "),
}
TIMES = (", ms", ", s")


@dataclass
class MeasuredTable:
    """A table with named columns.

    Attributes
    ----------
    title
        What was measured.
    columns
        Names; the word after the last comma says how values are written (``FORMATS``), as in "solve, ms".
    rows
        Raw values, seconds for times; None where there is none.
    notes
        Lines printed below.
    """

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[Any, ...]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, *values: Any) -> None:
        """Add a row."""
        if len(values) != len(self.columns):
            raise ValueError(f"{len(values)} values for {len(self.columns)} columns of {self.title!r}")
        self.rows.append(values)

    def note(self, line: str) -> None:
        """Add a line below the table, once."""
        if line not in self.notes:
            self.notes.append(line)

    def print(self, console: Console) -> None:
        """Print the table and its notes."""
        printed = Printed(title=self.title, title_justify="left", title_style="bold")
        for column in self.columns:
            heading = column if column.endswith(TIMES) else column.rpartition(", ")[0] or column
            printed.add_column(
                heading, justify="left" if column == self.columns[0] else "right", no_wrap=column == self.columns[0]
            )
        for row in self.rows:
            printed.add_row(*(self._text(column, value) for column, value in zip(self.columns, row, strict=True)))
        console.print(printed)
        for line in self.notes:
            console.print(line, style="dim", highlight=False)
        console.print()

    @staticmethod
    def _text(column: str, value: Any) -> str:
        kind = column.rpartition(", ")[2]
        return "-" if value is None else FORMATS.get(kind, str)(value)

    def as_json(self) -> dict[str, Any]:
        """Return the raw values; times are in seconds whatever the column's name says."""
        rows = [dict(zip((column.removesuffix(", ms") for column in self.columns), row, strict=True)) for row in self.rows]
        return {"title": self.title, "rows": rows, "notes": self.notes}
