"""Write the files of `probe-design tradeoff`: a Markdown page, a plot, a JSON file and a report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from geometry.common.files import written_together
from geometry.provenance.block import provenance
from probe_design.reports.page import Chapter, Items, PageTable, Picture, Text
from probe_design.reports.page import page as html
from probe_design.reports.scene_sections import asked
from probe_design.tradeoffs.plot import plot
from probe_design.tradeoffs.study import Tradeoff
from probe_design.tradeoffs.tables import CHOICES, EACH, NOTES, SUMMARY, choice_cells, page, row_cells, summary_cells

NAMES = ("tradeoff.png", "tradeoff.md", "tradeoff.json", "report.html")


def write_all(study: Tradeoff, folder: Path) -> list[Path]:
    """Write all files into ``folder``, all or none; return their paths.

    Raises:
        OSError: the folder cannot be written.
    """
    files = [folder / name for name in NAMES]
    summary = study.as_dict() | {"files": [str(file) for file in files], "provenance": provenance()}
    with written_together(folder, NAMES) as new:
        picture, table, data, told = (new / name for name in NAMES)
        plot(study, picture)
        table.write_text(page(study, picture.name), encoding="utf-8")
        data.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        told.write_text(_report(study, picture, summary), encoding="utf-8")
    return files


def _report(study: Tradeoff, picture: Path, summary: dict[str, Any]) -> str:
    """Build the report as HTML."""
    scenes = [asked(scene, f"The scene {name}") for name, scene in study.scenes.items()]
    refusals = [f"{row.scene}, {row.evaluator}: {row.reason}" for row in study.rows if row.reason is not None]
    silent = (*(f"{name}: {why}" for name, why in study.skipped.items()), *dict.fromkeys(refusals))
    sections = (
        Chapter("Error against time", (Picture.read(picture, "error against time of every evaluator and setting"),)),
        Chapter("Every setting", (PageTable(SUMMARY, tuple(summary_cells(study))), Text(NOTES.replace("`", "")))),
        Chapter("The cheapest for each scene", (PageTable(CHOICES, tuple(choice_cells(study))),)),
        Chapter("Every result", (PageTable(EACH, tuple(row_cells(study))),)),
        Chapter("Not evaluated, or no result", (Items(silent or ("nothing",)),)),
        *scenes,
    )
    headline = f"{len(study.rows)} results of {len(study.scenes)} scenes, timed and compared with a reference."
    return html("Speed against accuracy", headline, sections, summary)
