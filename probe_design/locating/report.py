"""Show what `locate` has inferred: tables and sentences for the terminal, and a page with pictures."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from geometry.common.files import write_together
from geometry.provenance.block import build_provenance
from geometry.scenes.units import MM_PER_M
from probe_design.estimation.measurements import FORCE_QUANTITY
from probe_design.locating.figures import LEGENDS, draw_fit, draw_marginals, draw_plan, draw_section
from probe_design.locating.location import Location, NumberResult
from probe_design.locating.posterior import LEARNT_SD_RELATIVE, Summary, find_places
from probe_design.reporting.page import Chapter, Items, Picture, Text, build_page
from probe_design.reporting.scene_sections import build_scene_section
from probe_design.reporting.table import Table

SHOWN_UNITS = {  # unit that is shown, and its number in an SI unit
    "x": ("mm", MM_PER_M), "y": ("mm", MM_PER_M), "depth": ("mm", MM_PER_M), "diameter": ("mm", MM_PER_M),
    "youngs_modulus": ("kPa", 1e-3), "ln_contrast": ("", 1.0),
}  # fmt: skip
QUANTITY_NAMES = {"youngs_modulus": "Young's modulus", "ln_contrast": "ln contrast"}
FILE_NAMES = ("report.html", "locate.json", "plan.png", "section.png", "marginals.png", "fit.png")

ASSUMPTIONS = (
    "The tumours are those of [population]: round, bonded to their tissue, and no more of them than it states.",
    "The noise is that of [noise]; a bench with more makes the regions too small. probe-design read measures it.",
    "Tissue, layers and the way in which the probe touches them are those of the design file, within the ranges that it states.",
)


def format_probability(value: float) -> str:
    """Return a probability with the digits that its sampling supports."""
    return f"{value:.1g}" if value < 0.01 else f"{value:.2f}"


def build_tables(result: Location) -> list[Table]:
    """Return the tables of a result: number of tumours; tumours of the most probable number above 0; gains and tissue."""
    common = [_build_common_table(result)] if result.nuisances else []
    return [_build_number_table(result), _build_tumour_table(result, result.best), *common]


def _title_tables(result: Location) -> Iterator[Text | Table]:
    """Yield the tables for a page, below the first their titles: of which number of tumours, and how probable that is."""
    first, *others = build_tables(result)
    yield first
    for table in others:
        yield Text(f"{table.title[:1].upper()}{table.title[1:]}:")
        yield table


def _build_common_table(result: Location) -> Table:
    """Return the table of gains, and of the numbers of the tissue that the population leaves open."""
    rows = []
    for name, summary in result.nuisances.items():
        label, unit, scale = _name_common(name)
        before = " to ".join(f"{scale * value:.3g}" for value in summary.before_90)
        rows.append(
            (f"{label}{', ' if unit else ''}{unit}", before, *_format_summary(summary, scale), _describe_learning(summary))
        )
    headings = ("quantity", "90 % before", "median", "50 %", "90 %", "readings")
    return Table(headings, rows, "common to all readings", left=(0, 5))


def _name_common(name: str) -> tuple[str, str, float]:
    """Return the words for a number that is common to the readings, the unit in which it is shown, and its factor from SI."""
    if name.startswith("ln_gain_"):
        return f"ln gain of the {name.removeprefix('ln_gain_')}", "", 1.0
    if name == "tissue":
        return "tissue's Young's modulus", "kPa", 1e-3
    _, number, quantity = name.split("_")
    words, unit, scale = ("thickness", "mm", MM_PER_M) if quantity == "thickness" else ("Young's modulus", "kPa", 1e-3)
    return f"layer {int(number) + 1}: {words}", unit, scale


def _build_number_table(result: Location) -> Table:
    """Return the table of the numbers of tumours."""
    rows = []
    for number, (before, after) in enumerate(zip(result.prior, result.probability, strict=False)):
        part = result.by_number[number - 1] if number else None
        factor = "0" if part is None else f"{part.log_bayes_factor:.1f} ± {max(part.log_bayes_factor_error, 0.05):.1f}"
        size = "" if part is None else f"{part.effective_sample_size:.0f}{'' if part.converged else ', not converged'}"
        at_least = format_probability(result.compute_probability_at_least(number)) if number else ""
        rows.append((str(number) if number else "none", f"{before:.2f}", format_probability(after), at_least, factor, size))
    rows += [(str(number), f"{result.prior[number]:.2f}", "withheld", "", "", "not converged") for number in result.withheld]
    headings = ("tumours", "before", "after", "this or more", "ln Bayes factor", "effective sample")
    return Table(headings, rows, f"{result.evaluator}, {result.seconds:.2g} s", left=(0,))


def _build_tumour_table(result: Location, part: NumberResult) -> Table:
    """Return the table of the tumours of one number, each with its quantities."""
    rows = []
    for index, tumour in enumerate(part.tumours):
        for name, summary in tumour.quantities.items():
            unit, scale = SHOWN_UNITS[name]
            label = f"{QUANTITY_NAMES.get(name, name)}{', ' if unit else ''}{unit}"
            label = label if len(part.tumours) == 1 else f"{index + 1}: {label}"
            rows.append((label, *_format_summary(summary, scale), _describe_learning(summary)))
    noun = "tumour" if part.number == 1 else "tumours"
    title = f"if {part.number} {noun} (probability {format_probability(result.probability[part.number])})"
    return Table(("quantity", "median", "50 %", "90 %", "readings"), rows, title, left=(0, 4))


def _describe_conditions(result: Location) -> str:
    """Say what the probabilities assume that the readings cannot check."""
    places = []
    for name, part in zip("xy", result.tumour_prior.ranges, strict=False):
        low, high = (MM_PER_M * limit for limit in (min(part.values), max(part.values)))
        places.append(f"{name} = {low:.3g}{f' to {high:.3g}' if low < high else ''} mm")
    return (
        "Conditional on the probe as drawn (calibrate it: readings hardly tell another one), on tumours within "
        f"{', '.join(places)} only ([population] margin allows more), and on the noise and the priors of the design file. "
        "It is no diagnosis: other causes of a stiff or soft place are not considered."
    )


def _format_summary(summary: Summary, scale: float) -> tuple[str, ...]:
    """Return median and both intervals as texts."""
    pairs = (summary.interval_50, summary.interval_90)
    return f"{scale * summary.median:.3g}", *(f"{scale * low:.3g} to {scale * high:.3g}" for low, high in pairs)


def _describe_learning(summary: Summary) -> str:
    """Say how far the readings narrow a quantity."""
    if summary.sd_relative is None:
        return "given"
    return f"sd {summary.sd_relative:.2f} of before" if summary.is_learnt else "as before the scan"


def list_lines(result: Location) -> Iterator[str]:
    """Yield the sentences below the tables."""
    yield build_headline(result)
    if (unlearnt := list_unlearnt(result)) and result.probability[0] < 0.5:
        yield f"Not learnt: {', '.join(unlearnt)}: as before the scan."
    yield from _describe_pose(result)
    yield _describe_conditions(result)
    if result.next is not None:
        x, y = result.next.x * MM_PER_M, result.next.y * MM_PER_M
        force = "" if result.next.force is None else f", {FORCE_QUANTITY.format_value(result.next.force)}"
        yield f"next: x = {x:.3g} mm, y = {y:.3g} mm{force}, expected information {result.next.information:.2g} nats"


def _describe_pose(result: Location) -> Iterator[str]:
    """Yield what is learnt of the places of presses by hand."""
    learnt, count = [], 0
    for part, before in zip(result.residuals, result.data.pose_sd.tolist(), strict=True):
        if (pose := part.pose_error) is not None:
            count += 1
            if pose.x_sd < LEARNT_SD_RELATIVE * before[0] or pose.y_sd < LEARNT_SD_RELATIVE * before[1]:
                learnt.append((part, pose))
    if learnt:
        part, pose = max(learnt, key=lambda row: math.hypot(row[1].x, row[1].y))
        x, y, x_error, y_error, x_sd, y_sd = (
            MM_PER_M * value for value in (part.x, part.y, pose.x, pose.y, pose.x_sd, pose.y_sd)
        )
        yield (
            f"Places: the readings narrow the error of {len(learnt)} of {count} presses, most far off at x = {x:.1f} mm, "
            f"y = {y:.1f} mm: by {x_error:+.1f} ± {x_sd:.1f} mm along x, {y_error:+.1f} ± {y_sd:.1f} mm along y."
        )
    elif count:
        yield "Places: the readings say nothing of how far presses stood off their places."


def list_unlearnt(result: Location) -> list[str]:
    """List the quantities of the most strongly read tumour, and of the tissue, that the readings do not narrow."""
    quantities = result.tumours[0].quantities
    of_tumour = [
        QUANTITY_NAMES.get(name, name) for name, part in quantities.items() if part.sd_relative is not None and not part.is_learnt
    ]
    return of_tumour + [_name_common(name)[0] for name, part in result.nuisances.items() if not part.is_learnt]


def build_headline(result: Location) -> str:
    """Return the result in a sentence."""
    if not result.explained:
        return f"No tumour of this population explains these readings (p = {result.p_value:.1g}); the numbers mean nothing then."
    none, many = result.probability[0], result.compute_probability_at_least(2)
    number = f"No tumour: probability {format_probability(none)}; two or more: {format_probability(many)}."
    if none > 0.5:
        return number
    tumour = result.tumours[0]
    places = [f"x = {MM_PER_M * x:.1f} mm, y = {MM_PER_M * y:.1f} mm" for x, y in find_places(*result.best.sets[:, 0, :2].T)]
    if len(places) == 1 and not any(tumour.quantities[name].is_learnt for name in "xy"):
        return f"{number} Where the clearest lies the readings do not tell."
    area = float(f"{tumour.place_region_90 * MM_PER_M**2:.2g}")  # rounded here, so that 140 is not written as 1.4e+02
    return f"{number} The clearest lies at {' or at '.join(places)}, within {area:g} mm² with a probability of 90 %."


def write_files(result: Location, folder: Path, first_chapters: Sequence[Chapter] = ()) -> list[Path]:
    """Write the page, its pictures and the JSON object into ``folder``, all or none; return their paths.

    The page begins with ``first_chapters``.

    Raises
    ------
    OSError
        The folder cannot be written.
    """
    files = [folder / name for name in FILE_NAMES]
    summary = result.as_dict() | {
        "files": [str(file) for file in files],
        "provenance": build_provenance(evaluator=result.evaluator, seed=result.seed),
    }
    drawings = {
        "plan.png": draw_plan(result), "section.png": draw_section(result), "marginals.png": draw_marginals(result),
        "fit.png": draw_fit(result),
    }  # fmt: skip
    with write_together(folder, FILE_NAMES) as draft:
        for name, figure in drawings.items():
            figure.savefig(draft / name, dpi=110)
        (draft / "locate.json").write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        warnings = [Chapter("Warnings", (Items(result.warnings),))] if result.warnings else []
        chapters = [
            *warnings,
            *first_chapters,
            Chapter("How many tumours", (*_title_tables(result), *(Text(line) for line in list_lines(result)))),
            *(
                Chapter(title, (Picture.from_file(draft / name, title), Text(LEGENDS[name])))
                for name, title in zip(drawings, ("Where", "How deep", "What is learnt", "Predicted and read"), strict=True)
            ),
            Chapter("What to keep in mind", (Items(ASSUMPTIONS),)),
            build_scene_section(result.scene, "The scene without tumours"),
        ]
        page = build_page("Tumours located", build_headline(result), chapters, summary, is_positive=result.explained)
        (draft / "report.html").write_text(page, encoding="utf-8")
    return files
