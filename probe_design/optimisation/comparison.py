"""What an optimisation found as rows of text: start and optimum side by side, limits, all judged designs."""

from __future__ import annotations

import csv
import io
import math

from rich.table import Table

from probe_design.optimisation.candidate import Candidate
from probe_design.optimisation.design_space import Limit
from probe_design.optimisation.optimum import Optimum

Row = tuple[str, str, str, str]
Cells = list[tuple[str, str, str]]  # quantity, value, the variable that limits hang on
MILLI, KILO = 1e-3, 1e3


def level_rows(optimum: Optimum) -> list[Row]:
    """Return the comparison: quantity, two designs of which the second is recommended, limits of the quantity."""
    (start, best), limits = _compared(optimum), optimum.limits
    rows = [
        (name, one, other, _limits(limits, variable))
        for (name, one, variable), (_, other, _) in zip(_design(start), _design(best), strict=True)
    ]
    rows += [(name, one, other, "") for (name, one), (_, other) in zip(_load(start), _load(best), strict=True)]
    for level in ("closed-form", optimum.judge, *(name for name in optimum.evaluators if name != optimum.judge)):
        for (name, one), (_, other) in zip(_told(start, level), _told(best, level), strict=True):
            rows.append((f"{name} by {level}", one, other, ""))
    if start.linear is not None or best.linear is not None:
        rows += [(name, one, other, "") for (name, one), (_, other) in zip(_more_load(start), _more_load(best), strict=True)]
    return rows


def levels_table(optimum: Optimum) -> Table:
    """Return the comparison as a table for the terminal."""
    title = "improved" if optimum.winner else "no gain, the start is exported"
    table = Table(title=f"optimize: {title}", caption=f"{noise_line(optimum)}; *: the limit is active")
    for heading in headings(optimum):
        table.add_column(heading, justify="left" if heading == "quantity" else "right")
    for row in level_rows(optimum):
        table.add_row(*row)
    return table


def headings(optimum: Optimum) -> Row:
    """Return the comparison's headings."""
    first, second = ("start", "recommended") if optimum.winner else ("best tried, no gain", "start, recommended")
    return ("quantity", first, second, "limits")


def _compared(optimum: Optimum) -> tuple[Candidate, Candidate]:
    """The start and what it is compared with, the recommended one last."""
    return (optimum.baseline, optimum.best) if optimum.winner else (optimum.found, optimum.baseline)


def noise_line(optimum: Optimum) -> str:
    """Say which noise the standard deviations count with."""
    noise = optimum.noise
    return f"noise {noise.ratio:g} on the ratio, {noise.charge * 1e12:g} pC on each channel's charge"


def candidates_csv(optimum: Optimum) -> str:
    """Return all judged designs, best first, as CSV with units in the headings."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [name for name, *_ in (*_design(optimum.baseline), *_load(optimum.baseline))]
    answers = ["ratio", "log_sensitivity", "error_estimate"]
    writer.writerow(["design", *names, "evaluator", "objective closed-form", "objective", "least", "most", *answers])
    for name, one in [("start", optimum.baseline), *((f"{k + 1}", c) for k, c in enumerate(optimum.candidates))]:
        judged = one.judged
        results = (one.searched_objective, one.judged_objective, one.least, one.most)
        values = (*results, judged.ratio, judged.log_sensitivity, judged.error_estimate)
        numbers = [f"{v:.6g}" if v is not None and math.isfinite(v) else "" for v in values]
        writer.writerow([name, *(cells[1] for cells in (*_design(one), *_load(one))), judged.evaluator, *numbers])
    return text.getvalue()


def _limits(limits: tuple[Limit, ...], variable: str) -> str:
    """The limits of a variable, an active one with a star: ``0.1* to 0.5``."""
    shown = {}
    for limit in limits:
        kind, _, of = limit.name.partition(" ")
        if of == variable:
            unit = KILO if "modulus" in of else 1.0 if of == "area_ratio" else MILLI
            shown[kind] = f"{limit.value / unit:.4g}{'*' * limit.active}"
    if len(shown) == 2:
        return f"{shown['least']} to {shown['largest']}"
    return "".join(f"{'from' if kind == 'least' else 'up to'} {text}" for kind, text in shown.items())


def _design(candidate: Candidate) -> Cells:
    probe = candidate.scene.probe
    heights = [f"{height / MILLI:.4g}" for height in dict.fromkeys((probe.core_height, probe.tube_height))]
    return [
        ("inner radius, mm", f"{probe.inner_radius / MILLI:.4g}", "inner_radius"),
        ("A2/A1", f"{probe.inner_area / probe.outer_area:.4g}", "area_ratio"),
        ("outer radius, mm", f"{probe.tube_radius / MILLI:.4g}", "outer_radius"),
        ("wall, mm", f"{(probe.tube_radius - probe.hole_radius) / MILLI:.4g}", "wall"),
        ("gap, mm", f"{probe.gap / MILLI:.4g}", "gap"),
        ("height, mm", " / ".join(heights), "height"),
        ("inner modulus, kPa", f"{probe.inner.youngs_modulus / KILO:.4g}", "inner_modulus"),
        ("outer modulus, kPa", f"{probe.outer.youngs_modulus / KILO:.4g}", "outer_modulus"),
    ]


def _load(candidate: Candidate) -> list[tuple[str, str]]:
    pressed = candidate.pressing
    depth = pressed.force / candidate.judged.stiffness if candidate.judged.stiffness else math.nan
    return [
        ("force, N", f"{pressed.force:.3g}"),
        ("indentation, mm", f"{depth / MILLI:.3g}"),
        ("force limited by", pressed.by),
    ]


def _more_load(candidate: Candidate) -> list[tuple[str, str]]:
    """Return rows on the gain of a load beyond the linear range."""
    linear, empty = candidate.less_pressed, ("largest linear load, N", "gain of more load, %", "its error, %")
    if linear is None:
        return [(name, "-") for name in empty]
    gain, error = candidate.gain_over(linear)
    shown = (f"{linear.pressing.force:.3g}", f"{100 * gain:.3g}", number(100 * error))
    return list(zip(empty, shown, strict=True))


def _told(candidate: Candidate, level: str) -> list[tuple[str, str]]:
    """Return an evaluator's results of a design; a linear evaluator's are under the largest linear load."""
    linear = candidate.linear or candidate
    if level == "closed-form":
        return _searched(linear)
    one = next((each for each in (candidate, linear) if each.judged.evaluator == level), None)
    return _judged(candidate, shown=False) if one is None else _judged(one)


def _searched(candidate: Candidate) -> list[tuple[str, str]]:
    return [
        ("log-sensitivity", number(candidate.searched.log_sensitivity if candidate.searched else None)),
        ("sd of ln E_object", number(candidate.searched_objective)),
    ]


def _judged(candidate: Candidate, *, shown: bool = True) -> list[tuple[str, str]]:
    result = candidate.judged
    rows = [
        ("ratio", result.ratio),
        ("error estimate", result.error_estimate),
        ("log-sensitivity", result.log_sensitivity),
        ("sd of ln E_object", candidate.judged_objective),
        ("least sd", candidate.least),
        ("most sd", candidate.most),
    ]
    return [(name, number(value if shown else None)) for name, value in rows]


def number(value: float | None) -> str:
    """Write a number with four digits, a dash where there is none."""
    return "-" if value is None or not math.isfinite(value) else f"{value:.4g}"
