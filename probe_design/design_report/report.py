"""What an optimisation for a population leaves behind: design, STEP files, drawing, pictures, table, report."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from geometry.provenance.block import Provenance, build_provenance
from geometry.provenance.texts import format_toml_comment
from geometry.scenes.scene_file import scene_to_toml
from probe_design.design_report.depth_map import DepthMap, compute_depth_map
from probe_design.design_report.judgement_pictures import plot_levers
from probe_design.design_report.levers import Lever, compute_levers
from probe_design.design_report.pictures import draw_front, draw_maps
from probe_design.design_report.table import build_table, describe_conditions, list_columns
from probe_design.design_search.outcome import PopulationOptimum
from probe_design.design_search.pareto import Front
from probe_design.populations.design_file import Design
from probe_design.reporting.page import Chapter, Code, Items, Picture, Text
from probe_design.reporting.page import build_page as html
from probe_design.reporting.scene_sections import build_scene_section, iterate_scene_sections
from probe_design.reporting.table import Table
from probe_design.reporting.workshop_command import WORKSHOP_PARTS

WRITING_STAGE = "writing STEP files, pictures and report"
FRONT_FILE = "pareto.png"
PICTURE_CAPTIONS = {
    "maps.png": "probability and standard deviation of ln contrast over depth and diameter",
    "levers.png": "the objective after each change of the readings",
    FRONT_FILE: "Pareto fronts",
    "drawing.png": "section and view of the probe",
}
TOLERANCE_NOTE = (
    "The objective by the closed form over 64 draws of what is built: radii and height to 0.05 mm, gap to 0.02 mm, each modulus "
    "to 10 % or to its material's own tolerance, one standard deviation each."
)
LIMITS_NOTE = (
    "linearity and gap_closure are forces, N: up to the first finite strain changes the ratio by at most 1 %, up to the second "
    "the gap stays open, for every tumour and tissue of the population, both with a margin of a tenth. They are lower than those "
    "of the one scene below."
)
Progress = Callable[[str, int, int], None]


def compute_maps(optimum: PopulationOptimum) -> dict[str, DepthMap]:
    """Return the map of each judged design by its heading."""
    return {
        name: compute_depth_map(optimum.design, verified.scene, verified.pressed.force)
        for name, verified in list_columns(optimum).items()
    }


def write_all(
    optimum: PopulationOptimum, folder: Path, progress: Progress, maps: dict[str, DepthMap], fronts: tuple[Front, ...] = (), *,
    force: bool = False, asking: str | None = None,
) -> list[Path]:  # fmt: skip
    """Write everything into ``folder``, all of it or nothing; see ``optimisation.report.write_all``.

    Raises:
        ExportError: a part is not what the parameters say.
        InputError: the folder holds another design.
        MissingLibrary: CAD cannot be loaded.
        OSError: the folder cannot be written.
    """
    progress(WRITING_STAGE, 0, 4)
    from geometry.cad.export import export_parts
    from geometry.cad.parts_record import RECORD_NAME, list_part_files
    from geometry.workshop.overview import draw_probe

    scene = optimum.scene
    probe, edge = scene.probe, scene.contact.edge_radius
    raised = compute_levers(scene, optimum.design)
    maximise = optimum.design.objective.maximise
    pictures: dict[str, Callable[[Path], object]] = {
        "drawing.png": lambda path: draw_probe(probe, path, edge),
        "maps.png": partial(draw_maps, maps, list_columns(optimum)),
        "levers.png": partial(plot_levers, raised, maximise),
    }
    if fronts:
        pictures[FRONT_FILE] = partial(draw_front, fronts, maximise)
    texts: dict[str, Callable[[], str]] = {
        "design.toml": lambda: format_toml_comment(_build_provenance(optimum)) + scene_to_toml(scene),
        "question.toml": lambda: format_toml_comment(_build_provenance(optimum)) + write_design_file(optimum.design),
        "optimize.json": lambda: json.dumps(build_summary(optimum, paths, raised, fronts), indent=2, allow_nan=False) + "\n",
    }
    names = [*list_part_files(probe), RECORD_NAME, *pictures, *texts, "report.html"]
    paths = [folder / name for name in names]

    def write_report(path: Path) -> None:
        answer = build_summary(optimum, paths, raised, fronts)
        path.write_text(build_page(optimum, maps, answer, path.parent, names[:-1]), encoding="utf-8")

    writers = {name: partial(_write, text) for name, text in texts.items()} | {"report.html": write_report}
    progress(WRITING_STAGE, 1, 4)
    export_parts(probe, folder, force, asking, {**pictures, **writers}, edge_radius=edge)
    progress(WRITING_STAGE, 4, 4)
    return paths


def build_summary(
    optimum: PopulationOptimum, files: Sequence[Path], raised: Sequence[Lever], fronts: tuple[Front, ...] = ()
) -> dict[str, Any]:
    """Return the JSON object of ``probe-design optimize DESIGN``."""
    additions = {
        "levers": [asdict(item) for item in raised],
        "pareto": [item.as_dict() for item in fronts],
        "provenance": _build_provenance(optimum),
    }
    return optimum.build_summary([str(file) for file in files]) | additions


def _build_provenance(optimum: PopulationOptimum) -> Provenance:
    return build_provenance(optimum.design.scene, evaluator=optimum.best.judgement.evaluator, seed=optimum.design.population.seed)


def write_design_file(design: Design) -> str:
    """Return the design file that was asked, written out with all defaults; it reads back as the same question."""
    import tomli_w

    from geometry.scenes.scene_file import scene_to_dict

    tables = design.model_dump(mode="json", exclude_none=True, exclude={"scene"})
    return tomli_w.dumps(tables | {"scene": scene_to_dict(design.scene)})


def build_page(
    optimum: PopulationOptimum, maps: dict[str, DepthMap], answer: dict[str, Any], folder: Path, files: Sequence[str]
) -> str:
    """Return the report as an HTML page.

    Args:
        optimum: that was found.
        maps: of each judged design.
        answer: what ``build_summary`` returns.
        folder: of the pictures, which go into the page.
        files: beside the page, that it links to.
    """
    verdict, pictures = optimum.verdict, {name: folder / name for name in PICTURE_CAPTIONS if name in files}
    parts = {
        name: (Picture.from_file(pictures[name], alt),) if name in pictures else () for name, alt in PICTURE_CAPTIONS.items()
    }
    limits = [(limit.name, f"{limit.value:.4g}", "yes" if limit.active else "no") for limit in optimum.limits]
    sections = (
        Chapter(
            "Start and optimum",
            (build_table(optimum, maps), *map(Text, _list_notes(optimum))),
        ),
        Chapter("Which tumours are detected and resolved", parts["maps.png"]),
        Chapter("What would help most", parts["levers.png"]),
        *((Chapter("What more would cost", parts[FRONT_FILE]),) if parts[FRONT_FILE] else ()),
        Chapter("Limits", (Table(("limit", "value, SI", "active"), limits), Text(LIMITS_NOTE))),
        Chapter(
            "After the workshop",
            (
                Text(TOLERANCE_NOTE),
                Table(("design", "as drawn", "expected", "5 % below", "95 % below"), _list_tolerances(optimum)),
            ),
        ),
        Chapter("What to machine", (*parts["drawing.png"], Items(tuple(files), links=True), *WORKSHOP_PARTS)),
        *iterate_scene_sections(optimum.scene, None),
        Chapter("What to keep in mind", (Items(tuple(optimum.warnings) or ("nothing",)),)),
        build_scene_section(optimum.scene, "The scene of the design"),
        Chapter("What was asked", (Code(write_design_file(optimum.design)),)),
    )
    headline, good = f"{verdict[0].upper()}{verdict[1:]}.", optimum.status == "improved"
    return html(title="Probe design", headline=headline, sections=sections, answer=answer, is_positive=good)


def _list_notes(optimum: PopulationOptimum) -> tuple[str, ...]:
    """What the numbers of the comparison mean."""
    single = (f"No design for one tumour: {optimum.why_no_single}.",) if optimum.why_no_single else ()
    return (
        f"{describe_conditions(optimum)}. The sampling error is one standard error, of the tumours drawn and of the "
        "draws of noise; the "
        "model error is a bound on what the evaluator's own errors change. Of the recommended design "
        f"{optimum.best.judgement.error_note}. A gain counts only where it is beyond twice its own error, for which the same "
        f"tumours are read with both probes, under one force for all of them. The search went by formulas: {optimum.how}.",
        *single,
    )


def _list_tolerances(optimum: PopulationOptimum) -> list[tuple[str, ...]]:
    names = ["start", *(f"design {k + 1}" for k in range(len(optimum.robust)))]
    names[optimum.status == "improved"] += ", recommended"
    return [
        (name, *(f"{value:.3g}" for value in (robust.nominal, robust.expected, robust.low, robust.high)))
        for name, robust in zip(names, optimum.robust, strict=False)
    ]


def _write(text: Callable[[], str], path: Path) -> None:
    path.write_text(text(), encoding="utf-8")
