"""Present a load curve: a table, and lines about the limits of the load."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table

    from solver.results.load_curve import LoadCurve

MAX_ROWS = 25  # at most


def build_load_table(curve: LoadCurve) -> Table:
    """Return a load curve as a table of at most 25 rows; null values are dashes."""
    from rich.table import Table

    table = Table(title=f"{curve.evaluator}, {len(curve.force)} loads in {curve.seconds:.2g} s")
    for heading in ("force, N", "indentation, mm", "ratio", "log_sensitivity", "walls, um", "strain", "error_estimate"):
        table.add_column(heading, justify="right")
    depth, walls = [1e3 * metres for metres in curve.indentation], [1e6 * metres for metres in curve.closest_walls]
    columns = (curve.force, depth, curve.ratio, curve.log_sensitivity, walls, curve.largest_strain, curve.error_estimate)
    rows = list(zip(*columns, strict=True))
    step = -(-len(rows) // MAX_ROWS)
    for row in rows[::-1][::step][::-1]:  # counted from the end, so that the last load is always shown
        digits = (4, 4, 6, 4, 4, 2, 2)
        table.add_row(*("-" if value is None else f"{value:.{d}g}" for value, d in zip(row, digits, strict=True)))
    return table


def list_load_lines(curve: LoadCurve) -> list[str]:
    """Return the limits of the load and the range of constant ratio, one line each."""
    lines = [] if curve.load_limits is None else list(curve.load_limits.sentences)
    if curve.constant_ratio is not None:
        force_range = f"{curve.constant_ratio.low:.3g} and {curve.constant_ratio.high:.3g} N"
        lines.append(f"the ratio is constant within {curve.constant_ratio.share:g} between {force_range}")
    return lines
