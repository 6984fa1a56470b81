"""Tables that never cut a word, and that escape control characters in texts."""

from __future__ import annotations

from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table

from geometry.common.errors import escape_unprintable

_UNLIMITED_WIDTH = 10_000  # characters, more than any table needs


class WholeTable:
    """A table at least as wide as its longest words; characters that cannot be printed, as in file names, are escaped."""

    def __init__(self, table: Table) -> None:
        self._table = table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render the table. Each column gets the width of its longest word as minimum, as rich cuts words otherwise."""
        wide_options = options.update(width=_UNLIMITED_WIDTH)
        for column in self._table.columns:
            words = (Measurement.get(console, wide_options, cell) for cell in (column.header, *column.cells))
            column.min_width = max(
                (measurement.maximum if column.no_wrap else measurement.minimum for measurement in words), default=1
            )
        min_width = Measurement.get(console, wide_options, self._table).minimum
        for part in console.render(self._table, options.update(width=max(min_width, options.max_width))):
            text = part.text if part.control else "\n".join(map(escape_unprintable, part.text.split("\n")))
            yield Segment(text, part.style, part.control)
