"""What an optimisation leaves behind: design, STEP files, drawing, table and report."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from html import escape
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

from geometry.provenance.block import Provenance, provenance
from geometry.provenance.texts import toml_comment
from geometry.scenes.scene_file import scene_to_dict, scene_to_toml
from probe_design.optimisation.candidate import Candidate
from probe_design.optimisation.comparison import candidates_csv, headings, level_rows, noise_line
from probe_design.optimisation.optimum import Optimum

PAGE = resources.files("probe_design.data").joinpath("report.html.in")


def write_all(
    optimum: Optimum, folder: Path, progress: Callable[[str, int, int], None], *, force: bool = False, asked: str | None = None
) -> list[Path]:
    """Write everything into ``folder``, all of it or nothing; the STEP files are checked before they take their names.

    ``force`` and ``asked`` are those of ``geometry.cad.export.export``.

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
        "report.html": lambda: page(optimum, [name for name in names if name not in ("report.html", "optimize.json")]),
        "optimize.json": lambda: json.dumps(summary(optimum, paths), indent=2, allow_nan=False) + "\n",
    }
    names = [*part_files(probe), NAME, "drawing.png", *texts]
    paths = [folder / name for name in names]

    def drawn(path: Path) -> None:
        progress("writing STEP files, drawing and report", 1, 3)
        draw(probe, path, edge)
        progress("writing STEP files, drawing and report", 2, 3)

    told = {name: partial(_write, text) for name, text in texts.items()}
    export(probe, folder, force, asked, {"drawing.png": drawn, **told}, edge_radius=edge)
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
        "status": optimum.status,
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
        "design": scene_to_dict(one.pressed),
    }


def page(optimum: Optimum, files: Sequence[str]) -> str:
    """Return the report as an HTML page."""
    warnings = dict.fromkeys(optimum.best.judged.warnings)
    candidates = list(csv.reader(io.StringIO(candidates_csv(optimum))))
    return Template(PAGE.read_text(encoding="utf-8")).substitute(
        headline=escape(optimum.verdict[0].upper() + optimum.verdict[1:] + "."),
        remarks="".join(f"<p><b>{escape(text)}.</b></p>" for text in optimum.remarks),
        noise=escape(noise_line(optimum)),
        levels=_html_table(headings(optimum), level_rows(optimum)),
        candidates=_html_table(candidates[0], candidates[1:]),
        warnings="".join(f"<li>{escape(text)}</li>" for text in warnings) or "<li>none</li>",
        files="".join(f'<li><a href="{escape(name)}">{escape(name)}</a></li>' for name in files),
        scene=escape(scene_to_toml(optimum.best.pressed)),
        judge=optimum.judges,
    )


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _html_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(text)}</th>" for text in headings)
    body = "".join("<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
