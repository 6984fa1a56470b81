"""What an optimisation leaves behind: design, STEP files, drawing, table and report."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from geometry.provenance.block import Provenance, build_provenance
from geometry.provenance.texts import format_toml_comment
from geometry.scenes.scene_file import scene_to_dict, scene_to_toml
from probe_design.optimisation.candidate import Candidate
from probe_design.optimisation.comparison import build_candidates_table, build_comparison_table, describe_noise
from probe_design.optimisation.optimum import Optimum
from probe_design.reporting.page import Chapter, Items, Picture, Text
from probe_design.reporting.page import build_page as html
from probe_design.reporting.scene_sections import build_scene_section, iterate_scene_sections
from probe_design.reporting.table import Table
from probe_design.reporting.workshop_command import WORKSHOP_PARTS


def write_all(
    optimum: Optimum, folder: Path, progress: Callable[[str, int, int], None], *, force: bool = False, question: str | None = None
) -> list[Path]:
    """Write everything into ``folder``, all of it or nothing; the STEP files are checked before they take their names.

    ``force`` and ``question`` are ``force`` and ``question_digest`` of ``geometry.cad.export.export_parts``.

    Raises:
        ExportError: a part is not what the parameters say.
        InputError: the folder holds another design.
        MissingLibrary: CAD cannot be loaded.
        OSError: the folder cannot be written.
    """
    progress("writing STEP files, drawing and report", 0, 3)
    from geometry.cad.export import export_parts
    from geometry.cad.parts_record import RECORD_NAME, list_part_files
    from geometry.workshop.overview import draw_probe

    probe, edge = optimum.best.scene.probe, optimum.best.scene.contact.edge_radius
    texts: dict[str, Callable[[], str]] = {
        "design.toml": lambda: format_toml_comment(_build_provenance(optimum)) + scene_to_toml(optimum.best.loaded_scene),
        "candidates.csv": lambda: build_candidates_table(optimum).to_csv(),
        "optimize.json": lambda: json.dumps(build_summary(optimum, paths), indent=2, allow_nan=False) + "\n",
    }
    names = [*list_part_files(probe), RECORD_NAME, "drawing.png", *texts, "report.html"]
    paths = [folder / name for name in names]

    def draw_section(path: Path) -> None:
        progress("writing STEP files, drawing and report", 1, 3)
        draw_probe(probe, path, edge)
        progress("writing STEP files, drawing and report", 2, 3)

    def write_report(path: Path) -> None:
        html_text = build_page(optimum, names[:-1], build_summary(optimum, paths), path.with_name("drawing.png"))
        path.write_text(html_text, encoding="utf-8")

    writers: dict[str, Callable[[Path], object]] = {"drawing.png": draw_section}
    writers |= {name: partial(_write_text, text) for name, text in texts.items()} | {"report.html": write_report}
    export_parts(probe, folder, force, question, writers, edge_radius=edge)
    progress("writing STEP files, drawing and report", 3, 3)
    return paths


def _write_text(text: Callable[[], str], path: Path) -> None:
    path.write_text(text(), encoding="utf-8")


def build_summary(optimum: Optimum, files: Sequence[Path]) -> dict[str, Any]:
    """Return the JSON object of ``probe-design optimize``; an objective is null where nothing can be told."""
    best, start = optimum.best, optimum.baseline
    return {
        "design": scene_to_dict(best.loaded_scene),
        "objective": _replace_non_finite(best.judged_objective),
        "baseline_objective": _replace_non_finite(start.judged_objective),
        "evaluator": best.judged.evaluator,
        "baseline_evaluator": start.judged.evaluator,
        "linear_evaluator": optimum.judge,
        "status": optimum.status,
        "recommended": "start" if optimum.winner is None else "optimum",
        "verdict": optimum.verdict,
        "remarks": list(optimum.remarks),
        "limits": [asdict(limit) for limit in optimum.limits],
        "noise": optimum.noise.ratio,
        "charge_noise": optimum.noise.charge,
        "files": [str(file) for file in files],
        "searched_objective": _replace_non_finite(best.searched_objective),
        "baseline_searched_objective": _replace_non_finite(start.searched_objective),
        "result": best.judged.as_dict(),
        "baseline_result": start.judged.as_dict(),
        "force": best.pressing.force,
        "force_limited_by": best.pressing.limited_by,
        "under_load": None if best.linear_candidate is None else _summarize_load_gain(best, best.linear_candidate),
        "baseline": _summarize_candidate(start),
        "candidates": [_summarize_candidate(candidate) for candidate in optimum.candidates],
        "provenance": _build_provenance(optimum),
    }


def _build_provenance(optimum: Optimum) -> Provenance:
    return build_provenance(optimum.baseline.scene, evaluator=optimum.judge)


def _summarize_candidate(candidate: Candidate) -> dict[str, Any]:
    return {
        "objective": _replace_non_finite(candidate.judged_objective),
        "objective_within": [candidate.objective_min, _replace_non_finite(candidate.objective_max)],
        "searched_objective": _replace_non_finite(candidate.searched_objective),
        "force": candidate.pressing.force,
        "force_limited_by": candidate.pressing.limited_by,
        "evaluator": candidate.judged.evaluator,
        "under_load": None if candidate.linear_candidate is None else _summarize_load_gain(candidate, candidate.linear_candidate),
        "design": scene_to_dict(candidate.loaded_scene),
    }


def _summarize_load_gain(candidate: Candidate, linear: Candidate) -> dict[str, Any]:
    """What more load than linear elasticity answers for brings: the share by which the objective is less, with its error."""
    gain, error = candidate.compute_gain(linear)
    return {
        "linear_force": linear.pressing.force,
        "linear_force_limited_by": linear.pressing.limited_by,
        "linear_objective": _replace_non_finite(linear.judged_objective),
        "linear_objective_within": [linear.objective_min, _replace_non_finite(linear.objective_max)],
        "gain": _replace_non_finite(gain),
        "gain_error": _replace_non_finite(error),
    }


def build_page(optimum: Optimum, files: Sequence[str], answer: dict[str, Any], drawing: Path | None = None) -> str:
    """Return the report as an HTML page.

    Args:
        optimum: that was found.
        files: beside it, that it links to.
        answer: what ``build_summary`` returns.
        drawing: the picture of the probe; none where it is not drawn.
    """
    best, linear = optimum.best.loaded_scene, (optimum.best.linear or optimum.best).loaded_scene
    limits = [(limit.name, f"{limit.value:.6g}", "yes" if limit.active else "no") for limit in optimum.limits]
    drawn = () if drawing is None else (Picture.from_file(drawing, "section and view of the probe"),)
    sections = (
        build_scene_section(optimum.baseline.scene),
        Chapter(
            "Start and optimum",
            (build_comparison_table(optimum), *map(Text, _list_notes(optimum))),
        ),
        Chapter("Limits of the search", (Table(("limit", "value, SI", "active"), limits),)),
        Chapter("What to machine", (*drawn, Items(tuple(files), links=True), *WORKSHOP_PARTS)),
        *iterate_scene_sections(linear, optimum.noise.ratio),
        Chapter("All judged designs", (build_candidates_table(optimum),)),
        Chapter("What to keep in mind", (Items((*optimum.remarks, *map(str, optimum.best.judged.warnings)) or ("nothing",)),)),
        build_scene_section(best, "The scene of the design"),
    )
    verdict = optimum.verdict
    headline, good = f"{verdict[0].upper()}{verdict[1:]}.", optimum.winner is not None
    return html(title="Probe design", headline=headline, sections=sections, answer=answer, is_positive=good)


def _list_notes(optimum: Optimum) -> tuple[str, ...]:
    """What the numbers of the comparison mean."""
    return (
        f"Standard deviations hold for {describe_noise(optimum)}. A star marks a limit that the design lies on. The search used "
        f"the closed form; {optimum.judge} judged. A gain counts only where it is beyond the errors of both designs: those of "
        f"the log-sensitivity and the ratio by {optimum.judge}, and what finite strain changes of both at the force. That is "
        "the least of what the scene's load gives on each design, the force at which finite strain changes the ratio by 1 %, "
        "and 1/20 of the force that closes the gap in linear elasticity; design.toml has it as its load. Lengths are rounded "
        "to 0.01 mm and moduli to three digits before they are judged: this table is the probe as it is drawn.",
        *_list_load_notes(optimum),
        "A standard deviation of ln E_object of 1 means that the stiffness is known to a factor of 2.7; well above 1 it "
        "cannot be told from one reading, however good the design (a tumour a hundred times stiffer than its tissue hardly "
        "feels different from a rigid one).",
    )


def _list_load_notes(optimum: Optimum) -> Iterator[str]:
    if any(candidate.linear is not None for candidate in (optimum.best, optimum.baseline)):
        yield (
            "The scene's load is more than linear elasticity answers for: contact judged the designs under the best of all loads "
            "up to it, as far as half an outer radius deep, with nine tenths of the load that closes the gap at most; then a "
            "gain counts beyond twice its error. Maps, sensitivities and stresses below are those of the largest load that "
            "linear elasticity answers for."
        )


def _replace_non_finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
