"""Present a load curve: a table, and lines about the limits of the load."""

from __future__ import annotations

from probe_design.reporting.table import Table
from solver.results.load_curve import LoadCurve

MAX_ROWS = 25  # at most


def build_load_table(curve: LoadCurve) -> Table:
    """Return a load curve as a table of at most 25 rows; null values are dashes."""
    title = f"{curve.evaluator}, {len(curve.force)} loads in {curve.seconds:.2g} s"
    columns = {
        "force, N": (curve.force, 4),
        "indentation, mm": ([1e3 * metres for metres in curve.indentation], 4),
        "ratio": (curve.ratio, 6),
        "log_sensitivity": (curve.log_sensitivity, 4),
        "walls, um": ([1e6 * metres for metres in curve.closest_walls], 4),
        "strain": (curve.largest_strain, 2),
        "error_estimate": (curve.error_estimate, 2),
    }
    return Table.from_columns(title, columns, MAX_ROWS, keep_last=True)


def list_load_lines(curve: LoadCurve) -> list[str]:
    """Return the limits of the load and the range of constant ratio, one line each."""
    lines = [] if curve.load_limits is None else list(curve.load_limits.sentences)
    if curve.constant_ratio is not None:
        force_range = f"{curve.constant_ratio.low:.3g} and {curve.constant_ratio.high:.3g} N"
        lines.append(f"the ratio is constant within {curve.constant_ratio.share:g} between {force_range}")
    return lines
