"""Tables, progress and messages for a person; everything but results goes to standard error."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Any

from geometry.common.errors import to_one_line
from geometry.common.json_types import JsonObject
from geometry.common.limits import format_maximum
from probe_design.reporting.table import Table, format_number, format_unit
from solver.results.result import ERROR_FIELDS, MAX_EFFECT

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress
    from rich.text import Text

    from probe_design.maps.detectability import Detectability
    from probe_design.maps.scan import Scan
    from solver.planning.plan import Plan
    from solver.results.result import Curve, Result

SHOWN_QUANTITIES = (
    "stress_inner", "stress_outer", "ratio", "log_sensitivity", "stiffness", "charge_inner", "charge_outer", "error_estimate",
    "stress_inner_error", "stress_outer_error", "stiffness_error", "equivalent_modulus", "residual", "frequency",
    "ratio_phase", "ratio_phase_error",
)  # fmt: skip

CURVE_ROWS, SCAN_ROWS, MAP_ROWS = 25, 41, 20  # largest numbers of rows of a table
_IS_QUIET: ContextVar[bool] = ContextVar("quiet", default=False)


@contextmanager
def use_quiet(is_quiet: bool) -> Iterator[None]:
    """Write neither progress nor notes inside the block, but results, warnings and requests to the user."""
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


def build_result_table(result: Result) -> Table:
    """Return the results of one evaluation as a table; null values are left out, and a warning gives the reason."""
    values = ((name, getattr(result, name)) for name in SHOWN_QUANTITIES)
    quantiles = ERROR_FIELDS if result.error_kind == "95 %" else ()
    rows = [
        (f"{name} (95 %)" if name in quantiles else name, format_number(value, 6), format_unit(name))
        for name, value in values
        if value is not None
    ]
    rows += [
        (f"{name} ({limit.basis_text})", format_maximum(limit.force, 3), "N")
        for name, limit in (("linear_limit_load", result.linear_limit_load), ("gap_closure_load", result.gap_closure_load))
        if limit is not None
    ]
    return Table(("quantity", "value", "unit"), rows, f"{result.evaluator}, {result.seconds:.2g} s", left=(0, 2))


def build_plan_table(plan: Plan) -> Table:
    """Return a plan as a table, one row for each decision."""
    rows = list[tuple[str, ...]]()
    for decision in plan.decisions:
        effects = (decision.effect, decision.effect_on_stresses, decision.effect_on_stiffness)
        sizes = ("-" if effect is None else "unknown" if effect >= MAX_EFFECT else f"{effect:.2g}" for effect in effects)
        rows.append((decision.feature, "yes" if decision.modelled else "no", *sizes))
    title = f"{plan.evaluator or 'no evaluator'}: {plan.dimension}"
    headings = ("feature", "modelled", "ratio", "stresses", "stiffness")
    return Table(headings, rows, title, "relative changes by each feature", left=(0, 1))


def list_plan_lines(plan: Plan) -> list[str]:
    """Return the reason for each decision, and the limits of the load, one line each."""
    return [
        *(f"{decision.feature}: {decision.reason}" for decision in plan.decisions),
        *(f"load: {line}" for line in plan.load_limits.sentences),
    ]


def build_curve_table(curve: Curve) -> Table:
    """Return a curve as a table of at most 25 rows; null values are dashes."""
    columns = {
        "youngs_modulus, Pa": (curve.youngs_modulus, 4),
        "ratio": (curve.ratio, 6),
        "log_sensitivity": (curve.log_sensitivity, 4),
        "error_estimate": (curve.error_estimate, 2),
    }
    title = f"{curve.evaluator}, {len(curve.ratio)} moduli in {curve.seconds:.2g} s"
    return Table.from_columns(title, columns, CURVE_ROWS)


def build_scan_table(scan: Scan) -> Table:
    """Return a scan as a table of at most 41 rows; null values are dashes."""
    cross_axis = "y" if scan.along == "x" else "x"
    line_text = f"along {scan.along} at {cross_axis} = {scan.at * 1e3:.6g} mm"
    columns = {
        "position, mm": ([1e3 * position for position in scan.position], 4),
        "ratio": (scan.ratio, 6),
        "stiffness, N/m": (scan.stiffness, 6),
        "log_sensitivity": (scan.log_sensitivity, 4),
        "error_estimate": (scan.error_estimate, 2),
    }
    title = f"{scan.evaluator}, {len(scan.ratio)} positions {line_text} in {scan.seconds:.2g} s"
    return Table.from_columns(title, columns, SCAN_ROWS)


def build_threshold_table(maps: Detectability) -> Table:
    """Return a table of the smallest detected and resolved diameters at some depths; a dash where there is none."""
    noise = f"noise {maps.noise:g} on the ratio"
    title = f"{maps.evaluator}, {len(maps.depth)} depths x {len(maps.diameter)} diameters in {maps.seconds:.2g} s, {noise}"
    diameters = [1e3 * diameter for diameter in maps.diameter]

    def find_ends(verdicts: Iterable[object]) -> tuple[float | None, float | None]:
        chosen = [diameter for diameter, verdict in zip(diameters, verdicts, strict=True) if verdict]
        return (chosen[0], chosen[-1]) if chosen else (None, None)

    columns: dict[str, tuple[Sequence[float | None], int]] = {
        "depth, mm": ([1e3 * depth for depth in maps.depth], 4),
        "largest that fits, mm": ([find_ends(change is not None for change in row)[1] for row in maps.change], 4),
        "detected from, mm": ([find_ends(row)[0] for row in maps.seen], 4),
        "resolved from, mm": ([find_ends(row)[0] for row in maps.resolved], 4),
    }
    return Table.from_columns(title, columns, MAP_ROWS)


def show_table(table: Table) -> None:
    """Write a table to standard output; on a narrow terminal the lines are longer, so that no number is cut."""
    from probe_design.terminal.whole_table import WholeTable

    make_console(stderr=False).print(WholeTable(table), soft_wrap=True)


def make_console(stderr: bool = True) -> Console:
    """Return the rich console of standard error or output; invalid sizes in ``COLUMNS`` and ``LINES`` are ignored."""
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
            if stage not in tasks:
                tasks[stage] = bars.add_task(to_one_line(stage), total=total)
            bars.update(tasks[stage], completed=done)

        yield update
