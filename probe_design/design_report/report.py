"""What an optimisation for a population leaves behind: design, STEP files, drawing, pictures, table, report."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

from geometry.provenance.block import Provenance, provenance
from geometry.provenance.texts import toml_comment
from geometry.scenes.scene_file import scene_to_toml
from probe_design.design_report.depth_map import DepthMap, depth_map
from probe_design.design_report.levers import levers
from probe_design.design_report.pictures import draw_front, draw_levers, draw_maps
from probe_design.design_report.table import caption, columns, rows
from probe_design.design_search.outcome import PopulationOptimum
from probe_design.design_search.pareto import Front
from probe_design.populations.design_file import Design

PAGE = resources.files("probe_design.data").joinpath("population_report.html.in")
STAGE = "writing STEP files, pictures and report"
FRONT = "pareto.png"
Progress = Callable[[str, int, int], None]


def maps_of(optimum: PopulationOptimum) -> dict[str, DepthMap]:
    """Return the map of each judged design by its heading."""
    return {name: depth_map(optimum.design, one.scene, one.pressed.force) for name, one in columns(optimum).items()}


def write_all(
    optimum: PopulationOptimum, folder: Path, progress: Progress, maps: dict[str, DepthMap], fronts: tuple[Front, ...] = (), *,
    force: bool = False, asked: str | None = None,
) -> list[Path]:  # fmt: skip
    """Write everything into ``folder``, all of it or nothing; see ``optimisation.report.write_all``.

    Raises:
        ExportError: a part is not what the parameters say.
        InputError: the folder holds another design.
        MissingLibrary: CAD cannot be loaded.
        OSError: the folder cannot be written.
    """
    progress(STAGE, 0, 4)
    from geometry.cad.drawing import draw
    from geometry.cad.export import export
    from geometry.cad.record import NAME, part_files

    scene = optimum.scene
    probe, edge = scene.probe, scene.contact.edge_radius
    raised = levers(optimum.design, optimum.found.scene)
    maximise = optimum.design.objective.maximise
    pictures: dict[str, Callable[[Path], object]] = {
        "drawing.png": lambda path: draw(probe, path, edge),
        "maps.png": partial(draw_maps, maps, columns(optimum)),
        "levers.png": partial(draw_levers, raised, maximise),
    }
    if fronts:
        pictures[FRONT] = partial(draw_front, fronts, maximise)
    texts: dict[str, Callable[[], str]] = {
        "design.toml": lambda: toml_comment(_origin(optimum)) + scene_to_toml(scene),
        "question.toml": lambda: toml_comment(_origin(optimum)) + question(optimum.design),
        "report.html": lambda: page(optimum, maps, [name for name in names if name not in ("report.html", "optimize.json")]),
        "optimize.json": lambda: json.dumps(summary(optimum, paths, raised, fronts), indent=2, allow_nan=False) + "\n",
    }
    names = [*part_files(probe), NAME, *pictures, *texts]
    paths = [folder / name for name in names]
    told = {name: partial(_write, text) for name, text in texts.items()}
    progress(STAGE, 1, 4)
    export(probe, folder, force, asked, {**pictures, **told}, edge_radius=edge)
    progress(STAGE, 4, 4)
    return paths


def summary(
    optimum: PopulationOptimum, files: Sequence[Path], raised: dict[str, float], fronts: tuple[Front, ...] = ()
) -> dict[str, object]:
    """Return the JSON object of ``probe-design optimize DESIGN``."""
    more = {"levers": raised, "pareto": [one.as_dict() for one in fronts], "provenance": _origin(optimum)}
    return optimum.summary([str(file) for file in files]) | more


def _origin(optimum: PopulationOptimum) -> Provenance:
    return provenance(optimum.design.scene, evaluator=optimum.best.judgement.evaluator, seed=optimum.design.population.seed)


def question(design: Design) -> str:
    """Return the design file that was asked, written out with all defaults; it reads back as the same question."""
    import tomli_w

    from geometry.scenes.scene_file import scene_to_dict

    tables = design.model_dump(mode="json", exclude_none=True, exclude={"scene"})
    return tomli_w.dumps(tables | {"scene": scene_to_dict(design.scene)})


def page(optimum: PopulationOptimum, maps: dict[str, DepthMap], files: Sequence[str]) -> str:
    """Return the report as an HTML page."""
    limits = [(one.name, f"{one.value:.4g}", "active" if one.active else "") for one in optimum.limits]
    tolerances = [
        (name, *(f"{value:.3g}" for value in (one.nominal, one.expected, one.low, one.high)))
        for name, one in zip(("start", *(f"design {k + 1}" for k in range(len(optimum.robust)))), optimum.robust, strict=False)
    ]
    front = f'<h2>What more would cost</h2><p><img src="{FRONT}" alt="Pareto fronts"></p>' if FRONT in files else ""
    return Template(PAGE.read_text(encoding="utf-8")).substitute(
        headline=escape(optimum.verdict[0].upper() + optimum.verdict[1:] + "."),
        rows=_html_table(("quantity", *columns(optimum)), list(rows(optimum, maps))),
        caption=escape(caption(optimum)),
        how=escape(optimum.how),
        single=escape(f"No design for one tumour: {optimum.why_no_single}." if optimum.why_no_single else ""),
        limits=_html_table(("limit", "value, SI", ""), limits),
        tolerances=_html_table(("design", "as drawn", "expected", "5 % below", "95 % below"), tolerances),
        front=front,
        warnings="".join(f"<li>{escape(text)}</li>" for text in optimum.warnings) or "<li>none</li>",
        files="".join(f'<li><a href="{escape(name)}">{escape(name)}</a></li>' for name in files),
        scene=escape(scene_to_toml(optimum.scene)),
        judge=escape(optimum.best.judgement.evaluator),
        maximise=escape(optimum.design.objective.maximise),
    )


def _write(text: Callable[[], str], path: Path) -> None:
    path.write_text(text(), encoding="utf-8")


def _html_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(text)}</th>" for text in headings)
    body = "".join("<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
