"""Tables whose words stay whole and whose texts do not speak to the terminal."""

from __future__ import annotations

from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table

from geometry.common.errors import printable

_ANY = 10_000  # columns, more than any table has


class WholeTable:
    """A table as wide as its longest words at least, with what cannot be printed, such as a file's name may have, as escapes."""

    def __init__(self, table: Table) -> None:
        self._table = table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render it; rich cuts words that are wider than what it leaves of a column, unless that is the column's least width."""
        wide = options.update(width=_ANY)
        for column in self._table.columns:
            words = (Measurement.get(console, wide, cell) for cell in (column.header, *column.cells))
            column.min_width = max((one.maximum if column.no_wrap else one.minimum for one in words), default=1)
        least = Measurement.get(console, wide, self._table).minimum
        for part in console.render(self._table, options.update(width=max(least, options.max_width))):
            text = part.text if part.control else "\n".join(map(printable, part.text.split("\n")))
            yield Segment(text, part.style, part.control)
