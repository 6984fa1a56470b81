"""Present a tolerance budget: a table, and lines about the outputs."""

from __future__ import annotations

from geometry.scenes.catalogue import format_modulus
from probe_design.reporting.table import Table
from probe_design.tolerances.budget import BudgetLine, ToleranceBudget

OUTPUT_NAMES = {
    "ln_ratio": "ratio",
    "ln_ratio_over_drawn_areas": "ratio over the drawn areas",
    "ln_stiffness": "stiffness by both films",
    "log_sensitivity": "log_sensitivity, absolute",
}


def build_tolerance_table(budget: ToleranceBudget) -> Table:
    """Return a budget as a table, the largest share of variance first."""
    title = f"{budget.evaluator}, {budget.samples} samples of closed-form, {budget.seconds:.2g} s"
    last = f"hold to, for {100 * budget.ratio:g} %"
    rows = list[tuple[str, ...]]()
    for line in budget.lines:
        part = line.outputs["ln_ratio"]
        ends = part.total_interval
        sobol = "-" if ends is None else f"{max(ends[0], 0.0):.3f} to {ends[1]:.3f}"
        required = "-" if line.held is None else _format_sd(line, line.held)
        moves = f"{100 * part.contribution:.2g} %"
        rows.append((line.name, _format_nominal(line), _format_sd(line, line.sd), moves, f"{part.share:.3f}", sobol, required))
    return Table(("what", "as drawn", "sd", "moves ratio", "share", "Sobol total, 95 %", last), rows, title)


def write_tolerance_lines(budget: ToleranceBudget) -> list[str]:
    """Return the standard deviation of each output, one line each."""
    lines = []
    for key, output in budget.outputs.items():
        absolute = key == "log_sensitivity"
        sd = f"{output.sd:.3g}" if absolute else f"{100 * output.sd:.3g} %"
        sampled_text = "no samples beside it"
        if output.sampled is not None and output.sampled_error is not None:
            scale, unit = (1.0, "") if absolute else (100.0, " %")
            sampled_text = f"samples {scale * output.sampled:.3g} +- {scale * output.sampled_error:.2g}{unit}"
        size = output.error_estimate
        error = ", error of it not known" if size is None else f", error of it {100 * size:.2g} % at most"
        lines.append(f"{OUTPUT_NAMES[key]}: standard deviation {sd} to first order, {sampled_text}{error}")
    return lines


def _format_nominal(line: BudgetLine) -> str:
    if line.kind == "length":
        return f"{1e3 * line.value:.4g} mm"
    return format_modulus(line.value) if line.kind == "modulus" else f"{line.value:.4g}"


def _format_sd(line: BudgetLine, sd: float) -> str:
    """Return a standard deviation as text in the unit of a workshop: um, mm or %."""
    if line.kind == "length":
        return f"{1e6 * sd:.2g} um" if sd < 1e-3 else f"{1e3 * sd:.2g} mm"
    return f"{sd:.2g}" if line.kind == "poisson_ratio" else f"{100 * sd / line.value:.2g} %"
