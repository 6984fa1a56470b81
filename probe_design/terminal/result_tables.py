"""Build the tables of results of the solver, and of scans and maps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from geometry.common.limits import format_maximum
from geometry.common.percent import format_percent
from probe_design.reporting.table import Table, format_number
from solver.results.record import ERROR_FIELDS, find_shown_unit
from solver.results.result import MAX_EFFECT

if TYPE_CHECKING:
    from probe_design.maps.detectability import Detectability
    from probe_design.maps.scan import Scan
    from solver.planning.plan import Plan
    from solver.results.result import Curve, LoadCurve, Result

STRESS_QUANTITIES = ("stress_inner", "stress_outer", "ratio", "log_sensitivity")
CHARGE_QUANTITIES = (
    "charge_inner", "charge_outer", "charge_per_force_inner", "charge_per_force_outer", "charge_ratio", "charge_log_sensitivity",
)  # fmt: skip
STRESS_ERRORS = ("error_estimate", "stress_inner_error", "stress_outer_error")
CHARGE_ERRORS = (
    "charge_ratio_error", "charge_inner_error", "charge_outer_error", "charge_per_force_inner_error",
    "charge_per_force_outer_error", "charge_log_sensitivity_error",
)  # fmt: skip
OTHER_QUANTITIES = ("equivalent_modulus", "residual", "frequency", "ratio_phase", "ratio_phase_error")
OBSERVABLE_WORDS = {"stress": "film stresses", "charge": "film charges"}

ERROR_DIGITS = 2  # significant ones of an error
CURVE_ROWS, SCAN_ROWS, MAP_ROWS = 25, 41, 20  # largest numbers of rows of a table


def build_result_table(result: Result) -> Table:
    """Return the results of one evaluation as a table; null values are left out, and a warning gives the reason."""
    by_charge = result.observable == "charge"
    kinds = (CHARGE_QUANTITIES, STRESS_QUANTITIES) if by_charge else (STRESS_QUANTITIES, CHARGE_QUANTITIES)
    errors = (CHARGE_ERRORS, STRESS_ERRORS) if by_charge else (STRESS_ERRORS, CHARGE_ERRORS)
    names = (*kinds[0], *kinds[1], "stiffness", *errors[0], *errors[1], "stiffness_error", *OTHER_QUANTITIES)
    values = ((name, getattr(result, name)) for name in names)
    quantiles = ERROR_FIELDS if result.error_kind == "95 %" else ()
    rows = list[tuple[str, str, str]]()
    for name, value in values:
        unit, scale = find_shown_unit(name)
        if value is not None:
            digits = ERROR_DIGITS if name in ERROR_FIELDS else 6
            rows.append((f"{name} (95 %)" if name in quantiles else name, format_number(scale * value, digits), unit))
    rows += [
        (f"{name} ({limit.basis_text})", format_maximum(limit.force, 3), "N")
        for name, limit in (("linear_limit_load", result.linear_limit_load), ("gap_closure_load", result.gap_closure_load))
        if limit is not None
    ]
    return Table(("quantity", "value", "unit"), rows, f"{result.evaluator}, {result.seconds:.2g} s", left=(0, 2))


def list_reading_lines(result: Result) -> list[str]:
    """Return in words what a reading of a scene with films is, and how well it determines E_object; no line without films."""
    read = result.reading
    preloaded = [f"Stresses, charges and their ratio are {result.response}."] if "preload" in (result.response or "") else []
    if result.charge_ratio is None or read.ratio is None:
        return preloaded
    within = "" if read.error is None else f" within {format_percent(read.error)}"
    text = f"A reading is the ratio of {OBSERVABLE_WORDS[result.observable]}, {read.ratio:.4g}{within}"
    if not read.log_sensitivity:
        return [*preloaded, f"{text}."]
    size = abs(read.log_sensitivity)
    change = f"it changes by {size:.3g} % per 1 % of E_object, so that 1 % of it is {0.01 / size:.2g} of ln E_object"
    return [*preloaded, f"{text}; {change}."]


def build_plan_table(plan: Plan) -> Table:
    """Return a plan as a table, one row for each decision."""
    rows = list[tuple[str, ...]]()
    for decision in plan.decisions:
        effects = (decision.effect, decision.effect_on_stresses, decision.effect_on_stiffness)
        sizes = ("-" if effect is None else "unknown" if effect >= MAX_EFFECT else format_percent(effect) for effect in effects)
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
    """Return a curve as a table of at most ``CURVE_ROWS`` rows; null values are dashes."""
    unit, scale = find_shown_unit("youngs_modulus")
    read, charge = curve.reading, "charge_" if curve.observable == "charge" else ""
    columns = {
        f"youngs_modulus, {unit}": ([scale * modulus for modulus in curve.youngs_modulus], 4),
        f"{charge}ratio": (read.ratio, 6),
        f"{charge}log_sensitivity": (read.log_sensitivity, 4),
        **_build_error_column(f"{charge}ratio", read.error),
    }
    title = f"{curve.evaluator}, {len(curve.ratio)} moduli in {curve.seconds:.2g} s"
    return Table.from_columns(title, columns, CURVE_ROWS)


def build_scan_table(scan: Scan) -> Table:
    """Return a scan as a table of at most ``SCAN_ROWS`` rows; null values are dashes."""
    cross_axis = "y" if scan.along == "x" else "x"
    line_text = f"along {scan.along} at {cross_axis} = {scan.at * 1e3:.6g} mm"
    read, charge = scan.reading, "charge_" if scan.observable == "charge" else ""
    columns = {
        "position, mm": ([1e3 * position for position in scan.position], 4),
        f"{charge}ratio": (read.ratio, 6),
        "stiffness, N/m": (scan.stiffness, 6),
        f"{charge}log_sensitivity": (read.log_sensitivity, 4),
        **_build_error_column(f"{charge}ratio", read.error),
    }
    title = f"{scan.evaluator}, {len(scan.ratio)} positions {line_text} in {scan.seconds:.2g} s"
    return Table.from_columns(title, columns, SCAN_ROWS)


def _build_error_column(ratio: str, errors: Sequence[float | None]) -> dict[str, tuple[list[float | None], int]]:
    """Return the column of the errors of a ratio, by its heading."""
    percent = [None if error is None else 100 * error for error in errors]
    return {f"{'error_estimate' if ratio == 'ratio' else 'charge_ratio_error'}, %": (percent, ERROR_DIGITS)}


def build_threshold_table(maps: Detectability) -> Table:
    """Return a table of the smallest detected and resolved diameters at some depths; a dash where there is none."""
    noise = f"noise {format_percent(maps.noise, 6)} on the ratio of {OBSERVABLE_WORDS[maps.observable]}"
    title = f"{maps.evaluator}, {len(maps.depth)} depths x {len(maps.diameter)} diameters in {maps.seconds:.2g} s, {noise}"
    diameters = [1e3 * diameter for diameter in maps.diameter]

    def find_ends(verdicts: Iterable[object]) -> tuple[float | None, float | None]:
        """Return the smallest and the largest diameter, mm, whose verdict is true; None twice if there is none."""
        chosen = [diameter for diameter, verdict in zip(diameters, verdicts, strict=True) if verdict]
        return (chosen[0], chosen[-1]) if chosen else (None, None)

    columns: dict[str, tuple[Sequence[float | None], int]] = {
        "depth, mm": ([1e3 * depth for depth in maps.depth], 4),
        "largest that fits, mm": ([find_ends(change is not None for change in row)[1] for row in maps.change], 4),
        "detected from, mm": ([find_ends(row)[0] for row in maps.seen], 4),
        "resolved from, mm": ([find_ends(row)[0] for row in maps.resolved], 4),
    }
    return Table.from_columns(title, columns, MAP_ROWS)


def build_load_table(curve: LoadCurve) -> Table:
    """Return a load curve as a table of at most ``CURVE_ROWS`` rows; null values are dashes."""
    title = f"{curve.evaluator}, {len(curve.force)} loads in {curve.seconds:.2g} s"
    read, charge = curve.reading, "charge_" if curve.observable == "charge" else ""
    columns = {
        "force, N": (curve.force, 4),
        "indentation, mm": ([1e3 * metres for metres in curve.indentation], 4),
        f"{charge}ratio": (read.ratio, 6),
        f"{charge}log_sensitivity": (read.log_sensitivity, 4),
        "walls, um": ([1e6 * metres for metres in curve.closest_walls], 4),
        "strain": (curve.largest_strain, 2),
        **_build_error_column(f"{charge}ratio", read.error),
    }
    return Table.from_columns(title, columns, CURVE_ROWS, keep_last=True)


def list_load_lines(curve: LoadCurve) -> list[str]:
    """Return the limits of the load and the range of constant ratio, one line each."""
    lines = [] if curve.load_limits is None else list(curve.load_limits.sentences)
    if curve.constant_ratio is not None:
        of_charges = " of charges" if curve.observable == "charge" else ""
        force_range = f"{curve.constant_ratio.low:.3g} and {curve.constant_ratio.high:.3g} N"
        lines.append(
            f"the ratio{of_charges} is constant within {format_percent(curve.constant_ratio.share)} between {force_range}"
        )
    return lines
