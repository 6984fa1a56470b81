"""What an optimisation found as rows of text: start and optimum side by side, limits, all judged designs."""

from __future__ import annotations

import math

from probe_design.optimisation.candidate import Candidate
from probe_design.optimisation.design_space import Limit
from probe_design.optimisation.optimum import Optimum
from probe_design.reporting.table import Table, format_number

Cells = list[tuple[str, str, str]]  # quantity, value, the variable that limits hang on
M_PER_MM, PA_PER_KPA = 1e-3, 1e3


def build_comparison_table(optimum: Optimum) -> Table:
    """Return the start and the best design beside each other, the recommended one last, with the limits of the quantities."""
    (start, best), limits = _select_compared(optimum), optimum.limits
    rows = [
        (name, first, second, _format_limits(limits, variable))
        for (name, first, variable), (_, second, _) in zip(_list_design_cells(start), _list_design_cells(best), strict=True)
    ]
    rows += [
        (name, first, second, "")
        for (name, first), (_, second) in zip(_list_load_cells(start), _list_load_cells(best), strict=True)
    ]
    for evaluator_name in ("closed-form", optimum.judge, *(name for name in optimum.evaluators if name != optimum.judge)):
        for (name, first), (_, second) in zip(
            _list_evaluator_cells(start, evaluator_name), _list_evaluator_cells(best, evaluator_name), strict=True
        ):
            rows.append((f"{name} by {evaluator_name}", first, second, ""))
    if start.linear is not None or best.linear is not None:
        rows += [
            (name, first, second, "")
            for (name, first), (_, second) in zip(_list_gain_cells(start), _list_gain_cells(best), strict=True)
        ]
    names = ("start", "recommended") if optimum.winner else ("best tried, no gain", "start, recommended")
    title = "improved" if optimum.winner else "no gain, the start is exported"
    caption = f"{describe_noise(optimum)}; *: the limit is active"
    return Table(("quantity", *names, "limits"), rows, f"optimize: {title}", caption)


def _select_compared(optimum: Optimum) -> tuple[Candidate, Candidate]:
    """The start and what it is compared with, the recommended one last."""
    return (optimum.baseline, optimum.best) if optimum.winner else (optimum.best_tried, optimum.baseline)


def describe_noise(optimum: Optimum) -> str:
    """Say which noise the standard deviations count with."""
    noise = optimum.noise
    return f"noise {noise.ratio:g} on the ratio, {noise.charge * 1e12:g} pC on each channel's charge"


def build_candidates_table(optimum: Optimum) -> Table:
    """Return all judged designs, best first, with units in the headings."""
    rows = list[tuple[str, ...]]()
    names = [name for name, *_ in (*_list_design_cells(optimum.baseline), *_list_load_cells(optimum.baseline))]
    answers = ["ratio", "log_sensitivity", "error_estimate"]
    headings = ("design", *names, "evaluator", "objective closed-form", "objective", "least", "most", *answers)
    for name, item in [("start", optimum.baseline), *((f"{k + 1}", c) for k, c in enumerate(optimum.candidates))]:
        judged = item.judged
        results = (item.searched_objective, item.judged_objective, item.objective_min, item.objective_max)
        values = (*results, judged.ratio, judged.log_sensitivity, judged.error_estimate)
        numbers = [f"{v:.6g}" if v is not None and math.isfinite(v) else "" for v in values]
        cells = (cell[1] for cell in (*_list_design_cells(item), *_list_load_cells(item)))
        rows.append((name, *cells, judged.evaluator, *numbers))
    return Table(headings, rows)


def _format_limits(limits: tuple[Limit, ...], variable: str) -> str:
    """The limits of a variable, an active one with a star: ``0.1* to 0.5``."""
    shown = {}
    for limit in limits:
        kind, _, limited_variable = limit.name.partition(" ")
        if limited_variable == variable:
            unit = PA_PER_KPA if "modulus" in limited_variable else 1.0 if limited_variable == "area_ratio" else M_PER_MM
            shown[kind] = f"{limit.value / unit:.4g}{'*' * limit.active}"
    if len(shown) == 2:
        return f"{shown['least']} to {shown['largest']}"
    return "".join(f"{'from' if kind == 'least' else 'up to'} {text}" for kind, text in shown.items())


def _list_design_cells(candidate: Candidate) -> Cells:
    probe = candidate.scene.probe
    heights = [f"{height / M_PER_MM:.4g}" for height in dict.fromkeys((probe.core_height, probe.tube_height))]
    return [
        ("inner radius, mm", f"{probe.inner_radius / M_PER_MM:.4g}", "inner_radius"),
        ("A2/A1", f"{probe.inner_area / probe.outer_area:.4g}", "area_ratio"),
        ("outer radius, mm", f"{probe.tube_radius / M_PER_MM:.4g}", "outer_radius"),
        ("wall, mm", f"{(probe.tube_radius - probe.hole_radius) / M_PER_MM:.4g}", "wall"),
        ("gap, mm", f"{probe.gap / M_PER_MM:.4g}", "gap"),
        ("height, mm", " / ".join(heights), "height"),
        ("inner modulus, kPa", f"{probe.inner.youngs_modulus / PA_PER_KPA:.4g}", "inner_modulus"),
        ("outer modulus, kPa", f"{probe.outer.youngs_modulus / PA_PER_KPA:.4g}", "outer_modulus"),
    ]


def _list_load_cells(candidate: Candidate) -> list[tuple[str, str]]:
    pressed = candidate.pressing
    depth = pressed.force / candidate.judged.stiffness if candidate.judged.stiffness else math.nan
    return [
        ("force, N", f"{pressed.force:.3g}"),
        ("indentation, mm", f"{depth / M_PER_MM:.3g}"),
        ("force limited by", pressed.limited_by),
    ]


def _list_gain_cells(candidate: Candidate) -> list[tuple[str, str]]:
    """Return rows on the gain of a load beyond the linear range."""
    linear, empty = candidate.linear_candidate, ("largest linear load, N", "gain of more load, %", "its error, %")
    if linear is None:
        return [(name, "-") for name in empty]
    gain, error = candidate.compute_gain(linear)
    shown = (f"{linear.pressing.force:.3g}", f"{100 * gain:.3g}", format_number(100 * error))
    return list(zip(empty, shown, strict=True))


def _list_evaluator_cells(candidate: Candidate, evaluator_name: str) -> list[tuple[str, str]]:
    """Return an evaluator's results of a design; a linear evaluator's are under the largest linear load."""
    linear = candidate.linear or candidate
    if evaluator_name == "closed-form":
        return _list_closed_form_cells(linear)
    evaluated = next((item for item in (candidate, linear) if item.judged.evaluator == evaluator_name), None)
    return _list_judged_cells(candidate, shown=False) if evaluated is None else _list_judged_cells(evaluated)


def _list_closed_form_cells(candidate: Candidate) -> list[tuple[str, str]]:
    return [
        ("log-sensitivity", format_number(candidate.searched.log_sensitivity if candidate.searched else None)),
        ("sd of ln E_object", format_number(candidate.searched_objective)),
    ]


def _list_judged_cells(candidate: Candidate, *, shown: bool = True) -> list[tuple[str, str]]:
    result = candidate.judged
    rows = [
        ("ratio", result.ratio),
        ("error estimate", result.error_estimate),
        ("log-sensitivity", result.log_sensitivity),
        ("sd of ln E_object", candidate.judged_objective),
        ("least sd", candidate.objective_min),
        ("most sd", candidate.objective_max),
    ]
    return [(name, format_number(value if shown else None)) for name, value in rows]
