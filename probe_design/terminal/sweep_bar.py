"""Show the progress of a sweep on standard error: a bar on a terminal, lines elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic

from rich.progress import BarColumn, SpinnerColumn, TextColumn
from rich.progress import Progress as Bars

from probe_design.sweeps.progress import EVERY, Progress, Tell
from probe_design.terminal.console import message, rich_console


@contextmanager
def shown() -> Iterator[Tell]:
    """Yield a function that shows the progress of a sweep on standard error."""
    console = rich_console()
    if console.is_terminal:
        with Bars(SpinnerColumn(), BarColumn(), TextColumn("{task.description}"), console=console, transient=True) as bars:
            task = bars.add_task("starting")
            yield lambda state: bars.update(task, description=state.line(), completed=state.done, total=state.total)
        return
    last = -EVERY

    def tell(state: Progress) -> None:
        nonlocal last
        if monotonic() - last >= EVERY or state.done == state.total:
            last = monotonic()
            message(state.line())

    yield tell
