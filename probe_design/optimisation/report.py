"""What an optimisation leaves behind: design, STEP files, drawing, table and report."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

from rich.table import Table

from geometry.common.files import write_text
from geometry.scenes.probe import Probe
from geometry.scenes.scene_file import scene_to_dict, scene_to_toml
from probe_design.optimisation.optimize import ACCURACY, Candidate, Optimum

Row = tuple[str, str, str]
PAGE = resources.files("probe_design.data").joinpath("report.html.in")


def write_all(
    optimum: Optimum, folder: Path, progress: Callable[[str, int, int], None], *, force: bool = False, asked: str | None = None
) -> list[Path]:
    """Write everything into ``folder``, each file whole; the STEP files are checked before they take their names.

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
    from geometry.cad.record import describe

    probe = optimum.best.scene.probe
    files = list(parts := export(probe, folder, force, asked))
    progress("writing STEP files, drawing and report", 1, 3)
    files.append(draw(probe, folder / "drawing.png"))
    progress("writing STEP files, drawing and report", 2, 3)
    files.append(write_text(folder / "design.toml", scene_to_toml(optimum.best.scene)))
    files.append(write_text(folder / "candidates.csv", candidates_csv(optimum)))
    files.append(write_text(folder / "report.html", page(optimum, [file.name for file in files])))
    listed = [*files, folder / "optimize.json"]
    files.append(write_text(folder / "optimize.json", json.dumps(summary(optimum, listed), indent=2, allow_nan=False) + "\n"))
    describe(folder, files[len(parts) :])
    progress("writing STEP files, drawing and report", 3, 3)
    return files


def summary(optimum: Optimum, files: Sequence[Path]) -> dict[str, Any]:
    """Return the JSON object of ``probe-design optimize``; an objective is null where nothing can be told."""
    best, start = optimum.best, optimum.baseline
    return {
        "design": scene_to_dict(best.scene),
        "objective": _finite(best.judged_objective),
        "baseline_objective": _finite(start.judged_objective),
        "evaluator": optimum.judge,
        "status": optimum.status,
        "files": [str(file) for file in files],
        "searched_objective": _finite(best.searched_objective),
        "baseline_searched_objective": _finite(start.searched_objective),
        "result": best.judged.as_dict(),
        "baseline_result": start.judged.as_dict(),
        "candidates": [
            {
                "objective": _finite(c.judged_objective),
                "searched_objective": _finite(c.searched_objective),
                "design": scene_to_dict(c.scene),
            }
            for c in optimum.candidates
        ],
    }


def level_rows(optimum: Optimum) -> list[Row]:
    """Return the comparison: quantity, start, optimum."""
    start, best = optimum.baseline, optimum.best
    rows = [
        (name, one, other) for (name, one), (_, other) in zip(_design(start.scene.probe), _design(best.scene.probe), strict=True)
    ]
    for level, pick in (("closed-form", _searched), (optimum.judge, _judged)):
        for (name, one), (_, other) in zip(pick(start), pick(best), strict=True):
            rows.append((f"{name} by {level}", one, other))
    return rows


def levels_table(optimum: Optimum) -> Table:
    """Return the comparison as a table for the terminal."""
    table = Table(title=f"optimize: {optimum.status}")
    for heading in ("quantity", "start", "optimum" if optimum.status == "improved" else "kept"):
        table.add_column(heading, justify="left" if heading == "quantity" else "right")
    for row in level_rows(optimum):
        table.add_row(*row)
    return table


def candidates_csv(optimum: Optimum) -> str:
    """Return all judged designs, best first, as CSV with units in the headings."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [name for name, _ in _design(optimum.baseline.scene.probe)]
    writer.writerow(
        ["design", *names, "objective closed-form", f"objective {optimum.judge}", "ratio", "log_sensitivity", "error_estimate"]
    )
    for name, candidate in [("start", optimum.baseline), *((f"{k + 1}", c) for k, c in enumerate(optimum.candidates))]:
        judged = candidate.judged
        results = (
            candidate.searched_objective,
            candidate.judged_objective,
            judged.ratio,
            judged.log_sensitivity,
            judged.error_estimate,
        )
        writer.writerow(
            [
                name,
                *(value for _, value in _design(candidate.scene.probe)),
                *(f"{v:.6g}" if v is not None else "" for v in results),
            ]
        )
    return text.getvalue()


def page(optimum: Optimum, files: Sequence[str]) -> str:
    """Return the report as an HTML page."""
    warnings = dict.fromkeys(optimum.best.judged.warnings)
    candidates = list(csv.reader(io.StringIO(candidates_csv(optimum))))
    return Template(PAGE.read_text(encoding="utf-8")).substitute(
        headline=escape(_headline(optimum)),
        levels=_html_table(("quantity", "start", "optimum"), level_rows(optimum)),
        candidates=_html_table(candidates[0], candidates[1:]),
        warnings="".join(f"<li>{escape(text)}</li>" for text in warnings) or "<li>none</li>",
        files="".join(f'<li><a href="{escape(name)}">{escape(name)}</a></li>' for name in files),
        scene=escape(scene_to_toml(optimum.best.scene)),
        judge=optimum.judge,
        slack=f"{500 * ACCURACY:g}",
    )


def _headline(optimum: Optimum) -> str:
    start, best, judge = optimum.baseline.judged_objective, optimum.best.judged_objective, optimum.judge
    if optimum.status == "no-gain":
        return f"No gain: {judge} sees no design that beats the start, whose standard deviation of ln E_object is {start:.3g}."
    return (
        f"The standard deviation of ln E_object falls from {start:.3g} to {best:.3g}, by {judge} (the search saw formulas only)."
    )


def _design(probe: Probe) -> list[tuple[str, str]]:
    heights = [f"{height * 1e3:.4g}" for height in dict.fromkeys((probe.core_height, probe.tube_height))]
    return [
        ("inner radius, mm", f"{probe.inner_radius * 1e3:.4g}"),
        ("A2/A1", f"{probe.inner_area / probe.outer_area:.4g}"),
        ("outer radius, mm", f"{probe.tube_radius * 1e3:.4g}"),
        ("gap, mm", f"{probe.gap * 1e3:.4g}"),
        ("height, mm", " / ".join(heights)),
        ("inner modulus, kPa", f"{probe.inner.youngs_modulus / 1e3:.4g}"),
        ("outer modulus, kPa", f"{probe.outer.youngs_modulus / 1e3:.4g}"),
    ]


def _searched(candidate: Candidate) -> list[tuple[str, str]]:
    return [
        ("log-sensitivity", _number(candidate.searched.log_sensitivity if candidate.searched else None)),
        ("sd of ln E_object", _number(candidate.searched_objective)),
    ]


def _judged(candidate: Candidate) -> list[tuple[str, str]]:
    result = candidate.judged
    return [
        ("ratio", _number(result.ratio)),
        ("error estimate", _number(result.error_estimate)),
        ("log-sensitivity", _number(result.log_sensitivity)),
        ("sd of ln E_object", _number(candidate.judged_objective)),
    ]


def _number(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.4g}"


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _html_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(text)}</th>" for text in headings)
    body = "".join("<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
