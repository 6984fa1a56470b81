"""Tables, progress and messages for a person; everything but results goes to standard error."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Any

from geometry.common.errors import to_one_line
from geometry.common.json_types import JsonObject
from probe_design.sweeps.progress import ReportProgress, report_at_intervals

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress
    from rich.text import Text

    from probe_design.reporting.table import Table


_IS_QUIET: ContextVar[bool] = ContextVar("quiet", default=False)


@contextmanager
def use_quiet(is_quiet: bool) -> Iterator[None]:
    """If ``is_quiet``, write no progress and no notes inside the block; results, warnings and prompts are always written."""
    token = _IS_QUIET.set(is_quiet)
    try:
        yield
    finally:
        _IS_QUIET.reset(token)


def write_line(text: str) -> None:
    """Write one line to standard error, always."""
    print(f"probe-design: {to_one_line(text)}", file=sys.stderr, flush=True)


def write_message(text: str) -> None:
    """Write one line to standard error, a note or a step, unless --quiet is given."""
    if not _IS_QUIET.get():
        write_line(text)


def warn(warnings: Iterable[str]) -> None:
    """Write each warning as a line to standard error."""
    for warning in warnings:
        write_line(f"warning: {warning}")


def show_table(table: Table) -> None:
    """Write a table to standard output; on a narrow terminal its lines exceed the width, so that no number is cut."""
    from probe_design.terminal.whole_table import WholeTable

    make_console(stderr=False).print(WholeTable(table), soft_wrap=True)


def make_console(stderr: bool = True) -> Console:
    """Return the rich console of standard error, or else of standard output.

    Invalid sizes in the environment variables ``COLUMNS`` and ``LINES`` are ignored: rich would fail on them.
    """
    from rich.console import Console

    sizes = (os.environ.get(name) for name in ("COLUMNS", "LINES"))
    if all(size is None or (size.isascii() and size.isdigit() and int(size) > 0) for size in sizes):
        return Console(stderr=stderr, markup=False, emoji=False)
    width, height = get_terminal_size()
    return Console(stderr=stderr, markup=False, emoji=False, width=width, height=height)


def find_terminal() -> Console | None:
    """Return the console of standard error if progress can be shown on it, else None."""
    return make_console() if sys.stderr.isatty() and not _IS_QUIET.get() else None


def _make_text(text: str) -> Text:
    """Return a line as text without rich's markup."""
    from rich.text import Text

    return Text(to_one_line(text))


def _make_bars(terminal: Console, transient: bool) -> Progress:
    """Make progress bars; ``transient`` ones disappear at the end."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    text = TextColumn("{task.description}", markup=False)
    columns = (SpinnerColumn(), text, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, console=terminal, transient=transient)


@contextmanager
def show_spinner(text: str) -> Iterator[None]:
    """Show a spinner with a text on a terminal."""
    terminal = find_terminal()
    with terminal.status(_make_text(text)) if terminal else nullcontext():
        yield


@contextmanager
def show_steps(text: str) -> Iterator[Callable[[str], None]]:
    """Yield a function (line) that shows the current step: next to a spinner on a terminal, as lines elsewhere."""
    terminal = find_terminal()
    if terminal is None:
        yield write_message
        return
    with terminal.status(_make_text(text)) as status:
        yield lambda line: status.update(_make_text(f"{text}: {line}"))


@contextmanager
def show_count(text: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function (done, total) that updates a progress bar on a terminal, and does nothing elsewhere."""
    terminal = find_terminal()
    if terminal is None:
        yield lambda done, total: None
        return
    with _make_bars(terminal, transient=True) as bars:
        task = bars.add_task(to_one_line(text), total=None)
        yield lambda done, total: bars.update(task, completed=done, total=total)


@contextmanager
def show_stages() -> Iterator[Any]:
    """Yield a function (stage, done, total) that shows a progress bar per stage, or lines without a terminal."""
    terminal = find_terminal()
    if terminal is None:
        yield lambda stage, done, total: write_message(f"{stage}: {done} of {total}") if done in (0, total) else None
        return
    with _make_bars(terminal, transient=False) as bars:
        tasks: JsonObject = {}

        def update(stage: str, done: int, total: int) -> None:
            """Move the bar of a stage, which is added on first use."""
            if stage not in tasks:
                tasks[stage] = bars.add_task(to_one_line(stage), total=total)
            bars.update(tasks[stage], completed=done)

        yield update


@contextmanager
def show_sweep() -> Iterator[ReportProgress]:
    """Yield a function that shows the progress of a sweep: a bar on a terminal, lines elsewhere."""
    terminal = find_terminal()
    if terminal is not None:
        from rich.progress import BarColumn, SpinnerColumn, TextColumn
        from rich.progress import Progress as Bars

        with Bars(SpinnerColumn(), BarColumn(), TextColumn("{task.description}"), console=terminal, transient=True) as bars:
            task = bars.add_task("starting")
            yield lambda state: bars.update(task, description=state.describe(), completed=state.done, total=state.total)
        return
    yield report_at_intervals(write_message)
