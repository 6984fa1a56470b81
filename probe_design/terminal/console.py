"""Tables, progress and messages for a person; everything but results goes to standard error."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Any

from geometry.common.errors import to_one_line
from geometry.common.limits import format_maximum

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table
    from rich.text import Text

    from probe_design.maps.detectability import Detectability
    from probe_design.maps.scan import Scan
    from solver.planning.plan import Plan
    from solver.results.result import Curve, Result

QUANTITY_UNITS = {
    "stress_inner": "Pa", "stress_outer": "Pa", "ratio": "", "log_sensitivity": "", "stiffness": "N/m", "charge_inner": "C",
    "charge_outer": "C", "error_estimate": "", "equivalent_modulus": "Pa", "residual": "",
    "frequency": "Hz", "ratio_phase": "rad", "ratio_phase_error": "rad",
}  # fmt: skip

CURVE_ROWS, SCAN_ROWS, MAP_ROWS = 25, 41, 20  # largest numbers of rows of a table


def write_message(text: str) -> None:
    """Write one line to standard error."""
    print(f"probe-design: {to_one_line(text)}", file=sys.stderr, flush=True)


def warn(warnings: Iterable[str]) -> None:
    """Write each warning as a line to standard error."""
    for warning in warnings:
        write_message(f"warning: {warning}")


def build_result_table(result: Result) -> Table:
    """Return the results of one evaluation as a table; null values are left out, and a warning gives the reason."""
    table = _make_table(title=f"{result.evaluator}, {result.seconds:.2g} s")
    for heading in ("quantity", "value", "unit"):
        table.add_column(heading, justify="right" if heading == "value" else "left")
    values = result.as_dict()
    for key, unit in QUANTITY_UNITS.items():
        if values[key] is not None:
            table.add_row(key, f"{values[key]:.6g}", unit)
    for name in ("linear_limit_load", "gap_closure_load"):
        limit = getattr(result, name)
        if limit is not None:
            table.add_row(f"{name} ({limit.basis_text})", format_maximum(limit.force, 3), "N")
    return table


def build_plan_table(plan: Plan) -> Table:
    """Return a plan as a table, one row for each decision."""
    from solver.results.result import MAX_EFFECT

    table = _make_table(title=f"{plan.evaluator or 'no evaluator'}: {plan.dimension}", caption="relative changes by each feature")
    for heading in ("feature", "modelled", "ratio", "stresses", "stiffness"):
        table.add_column(heading, justify="left" if heading in ("feature", "modelled") else "right", no_wrap=True)
    for decision in plan.decisions:
        effects = (decision.effect, decision.effect_on_stresses, decision.effect_on_stiffness)
        sizes = ("-" if effect is None else "unknown" if effect >= MAX_EFFECT else f"{effect:.2g}" for effect in effects)
        table.add_row(decision.feature, "yes" if decision.modelled else "no", *sizes)
    return table


def list_plan_lines(plan: Plan) -> list[str]:
    """Return the reason for each decision, and the limits of the load, one line each."""
    return [
        *(f"{decision.feature}: {decision.reason}" for decision in plan.decisions),
        *(f"load: {line}" for line in plan.load_limits.sentences),
    ]


def build_curve_table(curve: Curve) -> Table:
    """Return a curve as a table of at most 25 rows; null values are dashes."""
    table = _make_table(title=f"{curve.evaluator}, {len(curve.ratio)} moduli in {curve.seconds:.2g} s")
    for heading in ("youngs_modulus, Pa", "ratio", "log_sensitivity", "error_estimate"):
        table.add_column(heading, justify="right")
    step = -(-len(curve.ratio) // CURVE_ROWS)
    for row in list(zip(curve.youngs_modulus, curve.ratio, curve.log_sensitivity, curve.error_estimate, strict=True))[::step]:
        table.add_row(*("-" if value is None else f"{value:.{digits}g}" for value, digits in zip(row, (4, 6, 4, 2), strict=True)))
    return table


def build_scan_table(scan: Scan) -> Table:
    """Return a scan as a table of at most 41 rows; null values are dashes."""
    cross_axis = "y" if scan.along == "x" else "x"
    line_text = f"along {scan.along} at {cross_axis} = {scan.at * 1e3:.6g} mm"
    table = _make_table(title=f"{scan.evaluator}, {len(scan.ratio)} positions {line_text} in {scan.seconds:.2g} s")
    for heading in ("position, mm", "ratio", "stiffness, N/m", "log_sensitivity", "error_estimate"):
        table.add_column(heading, justify="right")
    columns = (
        [1e3 * position for position in scan.position],
        scan.ratio,
        scan.stiffness,
        scan.log_sensitivity,
        scan.error_estimate,
    )
    for row in list(zip(*columns, strict=True))[:: -(-len(scan.ratio) // SCAN_ROWS)]:
        table.add_row(
            *("-" if value is None else f"{value:.{digits}g}" for value, digits in zip(row, (4, 6, 6, 4, 2), strict=True))
        )
    return table


def build_threshold_table(maps: Detectability) -> Table:
    """Return a table of the smallest detected and resolved diameters at some depths; a dash where there is none."""
    noise = f"noise {maps.noise:g} on the ratio"
    title = f"{maps.evaluator}, {len(maps.depth)} depths x {len(maps.diameter)} diameters in {maps.seconds:.2g} s, {noise}"
    table = _make_table(title=title)
    for heading in ("depth, mm", "largest that fits, mm", "detected from, mm", "resolved from, mm"):
        table.add_column(heading, justify="right")
    for depth, *columns in list(zip(maps.depth, maps.change, maps.seen, maps.resolved, strict=True))[
        :: -(-len(maps.depth) // MAP_ROWS)
    ]:
        fits = [diameter for diameter, change in zip(maps.diameter, columns[0], strict=True) if change is not None]
        smallest = (next((d for d, verdict in zip(maps.diameter, row, strict=True) if verdict), None) for row in columns[1:])
        row = (depth, fits[-1] if fits else None, *smallest)
        table.add_row(*("-" if value is None else f"{1e3 * value:.4g}" for value in row))
    return table


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


def _make_table(title: str, caption: str | None = None) -> Table:
    from rich.table import Table  # imported late: --json into a file does not need rich

    return Table(title=title, caption=caption)


def _find_terminal() -> Console | None:
    """Return the console of standard error if it is a terminal, else None."""
    return make_console() if sys.stderr.isatty() else None


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
    terminal = _find_terminal()
    with terminal.status(_make_text(text)) if terminal else nullcontext():
        yield


@contextmanager
def show_steps(text: str) -> Iterator[Callable[[str], None]]:
    """Yield a function (line) that shows the current step: next to a spinner on a terminal, as lines elsewhere."""
    terminal = _find_terminal()
    if terminal is None:
        yield write_message
        return
    with terminal.status(_make_text(text)) as status:
        yield lambda line: status.update(_make_text(f"{text}: {line}"))


@contextmanager
def show_count(text: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function (done, total) that updates a progress bar on a terminal, and does nothing elsewhere."""
    terminal = _find_terminal()
    if terminal is None:
        yield lambda done, total: None
        return
    with _make_bars(terminal, transient=True) as bars:
        task = bars.add_task(to_one_line(text), total=None)
        yield lambda done, total: bars.update(task, completed=done, total=total)


@contextmanager
def show_stages() -> Iterator[Any]:
    """Yield a function (stage, done, total) that shows a progress bar per stage, or lines without a terminal."""
    terminal = _find_terminal()
    if terminal is None:
        yield lambda stage, done, total: write_message(f"{stage}: {done} of {total}") if done in (0, total) else None
        return
    with _make_bars(terminal, transient=False) as bars:
        tasks: dict[str, Any] = {}

        def update(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(to_one_line(stage), total=total)
            bars.update(tasks[stage], completed=done)

        yield update
