"""Present a tolerance budget and a rounded design: a table, and lines about outputs and sizes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geometry.common.percent import format_percent
from geometry.scenes.probe import format_mm
from geometry.scenes.units import format_modulus
from probe_design.reporting.table import Table

if TYPE_CHECKING:
    from probe_design.tolerancing.budget import BudgetLine, ToleranceBudget
    from probe_design.workshop.rounding import Rounding, RoundingCost

OUTPUT_NAMES = {
    "ln_ratio": "ratio",
    "ln_ratio_over_drawn_areas": "ratio over the drawn areas",
    "ln_stiffness": "stiffness by both films",
    "log_sensitivity": "log_sensitivity, absolute",
}


def build_tolerance_table(budget: ToleranceBudget) -> Table:
    """Return a budget of uncertainties as a table, one row for each number, the largest contribution to the ratio first."""
    title = f"{budget.evaluator}, {budget.samples} samples of closed-form, {budget.seconds:.2g} s"
    title += ", ratio of charges" if budget.observable == "charge" else ""
    last = f"hold to, for {format_percent(budget.ratio, 6)}"
    rows = list[tuple[str, ...]]()
    for line in budget.lines:
        part = line.outputs["ln_ratio"]  # the number's part in the variance of ln ratio
        ends = part.total_interval
        sobol = "-" if ends is None else f"{max(ends[0], 0.0):.3f} to {ends[1]:.3f}"
        required = "-" if line.held is None else _format_sd(line, line.held)
        moves = format_percent(part.contribution)
        rows.append((line.name, _format_nominal(line), _format_sd(line, line.sd), moves, f"{part.share:.3f}", sobol, required))
    return Table(("what", "as drawn", "sd", "moves ratio", "share", "Sobol total, 95 %", last), rows, title)


def write_tolerance_lines(budget: ToleranceBudget) -> list[str]:
    """Return the standard deviation of each output, one line each."""
    lines = []
    for key, output in budget.outputs.items():
        absolute = key == "log_sensitivity"
        sd = f"{output.sd:.3g}" if absolute else format_percent(output.sd, 3)
        sampled_text = "no samples beside it"
        if output.sampled is not None and output.sampled_error is not None:
            scale, unit = (1.0, "") if absolute else (100.0, " %")
            sampled_text = f"samples {scale * output.sampled:.3g} ± {scale * output.sampled_error:.2g}{unit}"
        size = output.error_estimate
        error = ", error of it not known" if size is None else f", error of it {format_percent(size)} at most"
        lines.append(f"{OUTPUT_NAMES[key]}: standard deviation {sd} to first order, {sampled_text}{error}")
    return lines


def _format_nominal(line: BudgetLine) -> str:
    """Return the nominal value of a number in its unit."""
    if line.kind == "length":
        return f"{1e3 * line.value:.4g} mm"
    if line.kind == "temperature":
        return f"{line.value:g} K"
    if line.kind == "charge":
        return f"{1e12 * line.value:.4g} pC/N"
    return format_modulus(line.value) if line.kind == "modulus" else f"{line.value:.4g}"


def _format_sd(line: BudgetLine, sd: float) -> str:
    """Return a standard deviation as text in the unit of a workshop: um, mm or %."""
    if line.kind == "length":
        return f"{1e6 * sd:.2g} um" if sd < 1e-3 else f"{1e3 * sd:.2g} mm"
    if line.kind == "temperature":
        return f"{sd:.2g} K"
    return f"{sd:.2g}" if line.kind == "poisson_ratio" else format_percent(sd / abs(line.value))


def write_rounding_lines(rounding: Rounding) -> list[str]:
    """Return the rounded sizes and the effect of rounding, one line each."""
    lines = [f"rounded: {change.key} = {format_mm(change.before)} to {format_mm(change.after)}" for change in rounding.changes]
    lines = lines or [f"rounded: nothing, all sizes are multiples of {format_mm(rounding.step)}"]
    cost_before, cost_after = rounding.before, rounding.after
    if cost_before is None or cost_after is None:
        return lines
    return [*lines, *(f"{key}: {_describe_change(cost_before, cost_after, key)}" for key in ("ratio", "log_sensitivity"))]


def _describe_change(cost_before: RoundingCost, cost_after: RoundingCost, key: str) -> str:
    """Return a number before and after rounding, and its relative change, as text."""
    old, new = getattr(cost_before, key), getattr(cost_after, key)
    if old is None or new is None:
        return "none"
    change_text = f" ({100 * (new / old - 1):+.2g} %)" if old else ""
    errors = [cost.error_estimate for cost in (cost_before, cost_after) if cost.error_estimate is not None]
    error_text = f", each within {format_percent(max(errors))}" if key == "ratio" and errors else ""
    return f"{old:.5g} to {new:.5g}{change_text} by {cost_after.evaluator}{error_text}"
