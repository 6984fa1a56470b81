"""What an optimisation leaves behind: design, STEP files, drawing, table and report."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from geometry.provenance.block import Provenance, provenance
from geometry.provenance.texts import toml_comment
from geometry.scenes.scene_file import scene_to_dict, scene_to_toml
from probe_design.optimisation.candidate import Candidate
from probe_design.optimisation.comparison import candidates_csv, headings, level_rows, noise_line
from probe_design.optimisation.optimum import Optimum
from probe_design.reports.page import Chapter, Items, PageTable, Picture, Text
from probe_design.reports.page import page as html
from probe_design.reports.scene_sections import asked, scene_sections
from probe_design.reports.workshop import FOR_THE_WORKSHOP


def write_all(
    optimum: Optimum, folder: Path, progress: Callable[[str, int, int], None], *, force: bool = False, question: str | None = None
) -> list[Path]:
    """Write everything into ``folder``, all of it or nothing; the STEP files are checked before they take their names.

    ``force`` and ``question`` are ``force`` and ``asked`` of ``geometry.cad.export.export``.

    Raises:
        ExportError: a part is not what the parameters say.
        InputError: the folder holds another design.
        MissingLibrary: CAD cannot be loaded.
        OSError: the folder cannot be written.
    """
    progress("writing STEP files, drawing and report", 0, 3)
    from geometry.cad.drawing import draw
    from geometry.cad.export import export
    from geometry.cad.record import NAME, part_files

    probe, edge = optimum.best.scene.probe, optimum.best.scene.contact.edge_radius
    texts: dict[str, Callable[[], str]] = {
        "design.toml": lambda: toml_comment(_origin(optimum)) + scene_to_toml(optimum.best.pressed),
        "candidates.csv": lambda: candidates_csv(optimum),
        "optimize.json": lambda: json.dumps(summary(optimum, paths), indent=2, allow_nan=False) + "\n",
    }
    names = [*part_files(probe), NAME, "drawing.png", *texts, "report.html"]
    paths = [folder / name for name in names]

    def drawn(path: Path) -> None:
        progress("writing STEP files, drawing and report", 1, 3)
        draw(probe, path, edge)
        progress("writing STEP files, drawing and report", 2, 3)

    def reported(path: Path) -> None:
        told = page(optimum, names[:-1], summary(optimum, paths), path.with_name("drawing.png"))
        path.write_text(told, encoding="utf-8")

    writers: dict[str, Callable[[Path], object]] = {"drawing.png": drawn}
    writers |= {name: partial(_write, text) for name, text in texts.items()} | {"report.html": reported}
    export(probe, folder, force, question, writers, edge_radius=edge)
    progress("writing STEP files, drawing and report", 3, 3)
    return paths


def _write(text: Callable[[], str], path: Path) -> None:
    path.write_text(text(), encoding="utf-8")


def summary(optimum: Optimum, files: Sequence[Path]) -> dict[str, Any]:
    """Return the JSON object of ``probe-design optimize``; an objective is null where nothing can be told."""
    best, start = optimum.best, optimum.baseline
    return {
        "design": scene_to_dict(best.pressed),
        "objective": _finite(best.judged_objective),
        "baseline_objective": _finite(start.judged_objective),
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
        "searched_objective": _finite(best.searched_objective),
        "baseline_searched_objective": _finite(start.searched_objective),
        "result": best.judged.as_dict(),
        "baseline_result": start.judged.as_dict(),
        "force": best.pressing.force,
        "force_limited_by": best.pressing.by,
        "under_load": None if best.less_pressed is None else _under_load(best, best.less_pressed),
        "baseline": _summary(start),
        "candidates": [_summary(one) for one in optimum.candidates],
        "provenance": _origin(optimum),
    }


def _origin(optimum: Optimum) -> Provenance:
    return provenance(optimum.baseline.scene, evaluator=optimum.judge)


def _summary(one: Candidate) -> dict[str, Any]:
    return {
        "objective": _finite(one.judged_objective),
        "objective_within": [one.least, _finite(one.most)],
        "searched_objective": _finite(one.searched_objective),
        "force": one.pressing.force,
        "force_limited_by": one.pressing.by,
        "evaluator": one.judged.evaluator,
        "under_load": None if one.less_pressed is None else _under_load(one, one.less_pressed),
        "design": scene_to_dict(one.pressed),
    }


def _under_load(one: Candidate, linear: Candidate) -> dict[str, Any]:
    """What more load than linear elasticity answers for brings: the share by which the objective is less, with its error."""
    gain, error = one.gain_over(linear)
    return {
        "linear_force": linear.pressing.force,
        "linear_force_limited_by": linear.pressing.by,
        "linear_objective": _finite(linear.judged_objective),
        "linear_objective_within": [linear.least, _finite(linear.most)],
        "gain": _finite(gain),
        "gain_error": _finite(error),
    }


def page(optimum: Optimum, files: Sequence[str], answer: dict[str, Any], drawing: Path | None = None) -> str:
    """Return the report as an HTML page.

    Args:
        optimum: that was found.
        files: beside it, that it links to.
        answer: what ``build_summary`` returns.
        drawing: the picture of the probe; none where it is not drawn.
    """
    best, linear = optimum.best.pressed, (optimum.best.linear or optimum.best).pressed
    rows = list(csv.reader(io.StringIO(candidates_csv(optimum))))
    limits = [(one.name, f"{one.value:.6g}", "yes" if one.active else "no") for one in optimum.limits]
    drawn = () if drawing is None else (Picture.read(drawing, "section and view of the probe"),)
    sections = (
        asked(optimum.baseline.scene),
        Chapter("Start and optimum", (_table(headings(optimum), level_rows(optimum)), *map(Text, _notes(optimum)))),
        Chapter("Limits of the search", (_table(("limit", "value, SI", "active"), limits),)),
        Chapter("What to machine", (*drawn, Items(tuple(files), links=True), *FOR_THE_WORKSHOP)),
        *scene_sections(linear, optimum.noise.ratio),
        Chapter("All judged designs", (_table(rows[0], rows[1:]),)),
        Chapter("What to keep in mind", (Items((*optimum.remarks, *map(str, optimum.best.judged.warnings)) or ("nothing",)),)),
        asked(best, "The scene of the design"),
    )
    verdict = optimum.verdict
    headline, good = f"{verdict[0].upper()}{verdict[1:]}.", optimum.winner is not None
    return html(title="Probe design", headline=headline, sections=sections, answer=answer, good=good)


def _notes(optimum: Optimum) -> tuple[str, ...]:
    """What the numbers of the comparison mean."""
    return (
        f"Standard deviations hold for {noise_line(optimum)}. A star marks a limit that the design lies on. The search used "
        f"the closed form; {optimum.judge} judged. A gain counts only where it is beyond the errors of both designs: those of "
        f"the log-sensitivity and the ratio by {optimum.judge}, and what finite strain changes of both at the force. That is "
        "the least of what the scene's load gives on each design, the force at which finite strain changes the ratio by 1 %, "
        "and 1/20 of the force that closes the gap in linear elasticity; design.toml has it as its load. Lengths are rounded "
        "to 0.01 mm and moduli to three digits before they are judged: this table is the probe as it is drawn.",
        *_pressed_notes(optimum),
        "A standard deviation of ln E_object of 1 means that the stiffness is known to a factor of 2.7; well above 1 it "
        "cannot be told from one reading, however good the design (a tumour a hundred times stiffer than its tissue hardly "
        "feels different from a rigid one).",
    )


def _pressed_notes(optimum: Optimum) -> Iterator[str]:
    if any(one.linear is not None for one in (optimum.best, optimum.baseline)):
        yield (
            "The scene's load is more than linear elasticity answers for: contact judged the designs under the best of all loads "
            "up to it, as far as half an outer radius deep, with nine tenths of the load that closes the gap at most; then a "
            "gain counts beyond twice its error. Maps, sensitivities and stresses below are those of the largest load that "
            "linear elasticity answers for."
        )


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> PageTable:
    return PageTable(tuple(headings), tuple(map(tuple, rows)))


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
