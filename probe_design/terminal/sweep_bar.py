"""Show the progress of a sweep on standard error: a bar on a terminal, lines elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic

from rich.progress import BarColumn, SpinnerColumn, TextColumn
from rich.progress import Progress as Bars

from probe_design.sweeps.progress import LOG_INTERVAL_S, Progress, Tell
from probe_design.terminal.console import find_terminal, write_message


@contextmanager
def show_sweep() -> Iterator[Tell]:
    """Yield a function that shows the progress of a sweep on standard error."""
    console = find_terminal()
    if console is not None:
        with Bars(SpinnerColumn(), BarColumn(), TextColumn("{task.description}"), console=console, transient=True) as bars:
            task = bars.add_task("starting")
            yield lambda state: bars.update(task, description=state.describe(), completed=state.done, total=state.total)
        return
    last_time = -LOG_INTERVAL_S

    def report(state: Progress) -> None:
        nonlocal last_time
        if monotonic() - last_time >= LOG_INTERVAL_S or state.done == state.total:
            last_time = monotonic()
            write_message(state.describe())

    yield report
