"""Build the report of an optimisation for one tumour read once: designs side by side with their limits, all verified designs."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from geometry.common.percent import format_percent
from geometry.provenance.block import build_provenance
from geometry.scenes.units import PA_PER_KPA
from probe_design.design_report.report import LIMIT_UNITS, Report, format_heights
from probe_design.design_report.verdict import list_assumptions, write_tumour_verdict
from probe_design.design_search.optimum import TumourOptimum
from probe_design.design_search.variables import M_PER_MM, Limit
from probe_design.design_search.verification import TumourVerification
from probe_design.reporting.page import Chapter
from probe_design.reporting.scene_sections import build_scene_section
from probe_design.reporting.table import Table, format_number

Cells = list[tuple[str, str]]  # quantity, value
LIMITED_QUANTITIES = {
    "inner radius, mm": "inner_radius", "A2/A1": "area_ratio", "outer radius, mm": "outer_radius", "wall, mm": "wall",
    "gap, mm": "gap", "height, mm": "height", "inner modulus, kPa": "inner_modulus", "outer modulus, kPa": "outer_modulus",
}  # fmt: skip
LOADED_NOTE = (
    "The scene's load is larger than linear elasticity allows: contact verified the designs under the best of all loads up to "
    "it, as far as half an outer radius deep, with nine tenths of the load that closes the gap at most; then a gain counts "
    "beyond twice its error. Maps, sensitivities and stresses below are those of the largest load that linear elasticity allows."
)
SCALE_NOTE = (
    "A standard deviation of ln E_object of 1 means that the stiffness is known to a factor of 2.7; well above 1 it cannot be "
    "determined from one reading, however good the design (a tumour a hundred times stiffer than its tissue hardly reads "
    "differently from a rigid one)."
)


def build_tumour_report(optimum: TumourOptimum) -> Report:
    """Return the report of an optimisation for the target of a scene."""
    best, scene, all_designs = optimum.best, optimum.design.scene, build_verified_table(optimum)
    loaded = any(design.linear is not None for design in (best, optimum.start))
    return Report(
        optimum=optimum,
        table=build_comparison_table(optimum),
        advice=write_tumour_verdict(optimum),
        assumptions=list_assumptions(optimum),
        notes=(_explain_verification(optimum), *([LOADED_NOTE] if loaded else []), SCALE_NOTE),
        provenance=build_provenance(scene, evaluator=optimum.linear_evaluator),
        cautions=(*optimum.warnings, *map(str, best.result.warnings)),
        shown_scene=(best.linear or best).loaded_scene,
        map_noise=optimum.noise.ratio,
        texts={"candidates.csv": all_designs.to_csv()},
        last_chapters=(Chapter("All verified designs", (all_designs,)), build_scene_section(scene, "What was asked")),
    )


def _explain_verification(optimum: TumourOptimum) -> str:
    """Return the note that explains standard deviations, errors and the force."""
    return (
        f"Standard deviations hold for {describe_noise(optimum)}. A star marks a limit that the design lies on. The search "
        f"used the closed form; {optimum.linear_evaluator} verified. A gain counts only where it is beyond the errors of "
        f"both designs: those of the log-sensitivity and the ratio by {optimum.linear_evaluator}, and what finite strain "
        "changes of both at the force. The force is the smallest of three: that of the scene's load on each design, the force at "
        "which finite strain changes the ratio by 1 %, and 1/20 of the force that closes the gap in linear elasticity; "
        "design.toml has it as its load. Lengths are rounded to 0.01 mm and moduli to three digits before they are verified: "
        "this table is the probe as it is drawn."
    )


def build_comparison_table(optimum: TumourOptimum) -> Table:
    """Return the table that compares start and other designs, the recommended one last, with the limits of each quantity.

    Rows are quantities, columns designs: first the probe and its load, then the results of each evaluator.
    """
    designs, limits = list(optimum.list_columns().values()), optimum.search_space.list_limits(optimum.best.scene)
    linear, others = optimum.linear_evaluator, [name for name in optimum.evaluators if name != optimum.linear_evaluator]

    def build_rows(list_cells: Callable[[TumourVerification], Cells], suffix: str = "") -> list[tuple[str, ...]]:
        """Return rows of the quantities that ``list_cells`` lists for a design, ``suffix`` added to their names."""
        columns = [list_cells(design) for design in designs]
        return [
            (
                f"{cells[0][0]}{suffix}",
                *(text for _, text in cells),
                _format_limits(limits, LIMITED_QUANTITIES.get(cells[0][0], "")),
            )
            for cells in zip(*columns, strict=True)
        ]

    rows = build_rows(_list_design_cells) + build_rows(_list_load_cells)
    for name in ("closed-form", linear, *others):
        rows += build_rows(partial(_list_evaluator_cells, evaluator_name=name), f" by {name}")
    rows += build_rows(_list_gain_cells) if any(design.linear is not None for design in designs) else []
    caption = f"{describe_noise(optimum)}; *: the limit is active"
    return Table(("quantity", *optimum.list_columns(), "limits"), rows, optimum.title, caption)


def describe_noise(optimum: TumourOptimum) -> str:
    """Return the noise for which the standard deviations hold, in words."""
    noise = optimum.noise
    observable = "ratio of charges" if optimum.design.scene.observable == "charge" else "ratio"
    return f"noise {format_percent(noise.ratio, 6)} on the {observable}, {noise.charge * 1e12:g} pC on each channel's charge"


def build_verified_table(optimum: TumourOptimum) -> Table:
    """Return a table with a row for each verified design: the start, then the others, best first; headings have units."""
    names = [name for name, _ in (*_list_design_cells(optimum.start), *_list_load_cells(optimum.start))]
    number_headings = ("objective closed-form", "objective", "least", "most", "ratio", "log_sensitivity", "error_estimate")
    rows = list[tuple[str, ...]]()
    for name, item in [("start", optimum.start), *((f"{k + 1}", item) for k, item in enumerate(optimum.finalists))]:
        read = item.result.reading
        values = (item.formula_value, item.value, item.lower, item.upper, read.ratio, read.log_sensitivity, read.error)
        cells = [text for _, text in (*_list_design_cells(item), *_list_load_cells(item))]
        rows.append((name, *cells, item.evaluator, *(f"{v:.6g}" if v is not None and math.isfinite(v) else "" for v in values)))
    return Table(("design", *names, "evaluator", *number_headings), rows)


def _format_limits(limits: tuple[Limit, ...], variable: str) -> str:
    """Return the limits of a variable as text in mm, kPa or a pure number, an active one with a star: ``0.1* to 0.5``."""
    shown = {}
    for limit in limits:
        kind, _, limited_variable = limit.name.partition(" ")
        if limited_variable == variable:
            unit, _ = LIMIT_UNITS.get(variable, (M_PER_MM, " mm"))
            shown[kind] = f"{limit.value / unit:.4g}{'*' * limit.active}"
    if len(shown) == 2:
        return f"{shown['least']} to {shown['largest']}"
    return "".join(f"{'from' if kind == 'least' else 'up to'} {text}" for kind, text in shown.items())


def _list_design_cells(verified: TumourVerification) -> Cells:
    """Return the sizes and moduli of a design's probe."""
    probe = verified.scene.probe
    return [
        ("inner radius, mm", f"{probe.inner_radius / M_PER_MM:.4g}"),
        ("A2/A1", f"{probe.inner_area / probe.outer_area:.4g}"),
        ("outer radius, mm", f"{probe.tube_radius / M_PER_MM:.4g}"),
        ("wall, mm", f"{(probe.tube_radius - probe.hole_radius) / M_PER_MM:.4g}"),
        ("gap, mm", f"{probe.gap / M_PER_MM:.4g}"),
        ("height, mm", format_heights(probe)),
        ("inner modulus, kPa", f"{probe.inner.youngs_modulus / PA_PER_KPA:.4g}"),
        ("outer modulus, kPa", f"{probe.outer.youngs_modulus / PA_PER_KPA:.4g}"),
    ]


def _list_load_cells(verified: TumourVerification) -> Cells:
    """Return force and indentation of a design, and what limits the force."""
    force, limited_by = verified.force
    depth = force / verified.result.stiffness if verified.result.stiffness else math.nan
    return [("force, N", f"{force:.3g}"), ("indentation, mm", f"{depth / M_PER_MM:.3g}"), ("force limited by", limited_by)]


def _list_gain_cells(verified: TumourVerification) -> Cells:
    """Return the gain of a load beyond linear elasticity over the largest within it; dashes for a load within it."""
    linear, names = verified.linear_design, ("largest linear load, N", "gain of more load, %", "its error, %")
    if linear is None:
        return [(name, "-") for name in names]
    gain, error = verified.compute_gain(linear)
    shown = (f"{linear.pressing.force:.3g}", f"{100 * gain:.3g}", format_number(100 * error))
    return list(zip(names, shown, strict=True))


def _list_evaluator_cells(verified: TumourVerification, evaluator_name: str) -> Cells:
    """Return an evaluator's results for a design, dashes if it did not verify the design.

    A linear evaluator's are those under the largest load within linear elasticity.
    """
    linear = verified.linear or verified
    if evaluator_name == "closed-form":
        sensitivity = linear.formula_result.reading.log_sensitivity if linear.formula_result else None
        return [
            ("log-sensitivity", format_number(sensitivity)),
            ("sd of ln E_object", format_number(linear.formula_value)),
        ]
    evaluated = next((item for item in (verified, linear) if item.evaluator == evaluator_name), None)
    shown = evaluated or verified
    read = shown.result.reading
    rows = [
        ("ratio", read.ratio),
        ("error estimate, %", None if read.error is None else 100 * read.error),
        ("log-sensitivity", read.log_sensitivity),
        ("sd of ln E_object", shown.value),
        ("sd, lower bound", shown.lower),
        ("sd, upper bound", shown.upper),
    ]
    return [(name, format_number(value if evaluated else None)) for name, value in rows]
