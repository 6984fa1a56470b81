"""Tables that never cut a word, and that escape control characters in texts."""

from __future__ import annotations

from collections.abc import Iterable

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table as Grid

from geometry.common.errors import escape_unprintable
from probe_design.reporting.table import Table

_UNLIMITED_WIDTH = 10_000  # characters, more than any table needs
_MAX_LABEL_WIDTH = 36  # characters of cells that stay whole in files and pipes, which have no width: the longest label has 32


class WholeTable:
    """A table at least as wide as its numbers and names; its lines are thinner where a terminal is narrow.

    Headings and sentences are wrapped at words. Characters that cannot be printed, as in file names, are escaped.
    """

    def __init__(self, table: Table) -> None:
        """Wrap ``table`` for printing by rich."""
        self._table = table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render the table. Each column is at least as wide as its longest word or number, which rich would cut otherwise."""
        grid = self._build_grid(0 if console.is_terminal else _MAX_LABEL_WIDTH)
        wide_options = options.update(width=_UNLIMITED_WIDTH)
        if console.is_terminal and Measurement.get(console, wide_options, grid).maximum > options.max_width:
            grid.box, grid.padding, grid.pad_edge = SIMPLE_HEAD, (0, 1, 0, 0), False
        min_width = Measurement.get(console, wide_options, grid).minimum
        for part in console.render(grid, options.update(width=max(min_width, options.max_width))):
            text = part.text if part.control else "\n".join(map(escape_unprintable, part.text.split("\n")))
            yield Segment(text, part.style, part.control)

    def _build_grid(self, max_label_width: int) -> Grid:
        """Build rich's table, with the widest word or unbroken cell of each column as its minimum width.

        A column of sentences is broken at words only if a cell is wider than ``max_label_width``, in characters.
        """
        table = self._table
        grid = Grid(title=table.title or None, caption=table.caption or None, caption_justify="left")
        for k, heading in enumerate(table.headings):
            cells = [row[k] for row in table.rows]
            may_wrap = table.is_wordy(k) and max(map(cell_len, cells), default=0) > max_label_width
            unbroken = [*heading.split(), *(_split_words(cells) if may_wrap else cells)]
            grid.add_column(
                heading, justify="left" if k in table.left else "right", min_width=max(map(cell_len, unbroken), default=1) or 1
            )
        for row in table.rows:
            grid.add_row(*row)
        return grid


def _split_words(texts: Iterable[str]) -> list[str]:
    """Return all words of some texts."""
    return [word for text in texts for word in text.split()]
