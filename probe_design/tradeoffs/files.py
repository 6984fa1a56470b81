"""Write the files of `probe-design tradeoff`: a Markdown page, a plot, a JSON file and a report."""

from __future__ import annotations

import json
from pathlib import Path

from geometry.common.files import write_together
from geometry.provenance.block import build_provenance
from probe_design.reporting.page import Chapter, Items, Picture, Text
from probe_design.reporting.page import build_page as html
from probe_design.reporting.scene_sections import build_scene_section
from probe_design.reporting.table import Table
from probe_design.tradeoffs.plot import plot_tradeoff
from probe_design.tradeoffs.study import Tradeoff
from probe_design.tradeoffs.tables import (
    CHOICE_HEADINGS,
    COLUMN_NOTES,
    ROW_HEADINGS,
    SUMMARY_HEADINGS,
    build_choice_cells,
    build_markdown_page,
    build_row_cells,
    build_summary_cells,
)

FILE_NAMES = ("tradeoff.png", "tradeoff.md", "tradeoff.json", "report.html")


def write_all(study: Tradeoff, folder: Path) -> list[Path]:
    """Write all files into ``folder``, all or none; return their paths.

    Raises
    ------
    OSError
        The folder cannot be written.
    """
    files = [folder / name for name in FILE_NAMES]
    summary = study.as_dict() | {"files": [str(file) for file in files], "provenance": build_provenance()}
    with write_together(folder, FILE_NAMES) as new:
        picture, table, data, report = (new / name for name in FILE_NAMES)
        plot_tradeoff(study, picture)
        table.write_text(build_markdown_page(study, picture.name), encoding="utf-8")
        data.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        report.write_text(_build_report(study, picture, summary), encoding="utf-8")
    return files


def _build_report(study: Tradeoff, picture: Path, summary: dict[str, object]) -> str:
    """Build the report as HTML."""
    scenes = [build_scene_section(scene, f"The scene {name}") for name, scene in study.scenes.items()]
    refusals = [f"{row.scene}, {row.evaluator}: {row.reason}" for row in study.rows if row.reason is not None]
    unanswered = (*(f"{name}: {reason}" for name, reason in study.skipped.items()), *dict.fromkeys(refusals))
    sections = (
        Chapter("Error against time", (Picture.from_file(picture, "error against time of every evaluator and setting"),)),
        Chapter("Every setting", (Table(SUMMARY_HEADINGS, build_summary_cells(study)), Text(COLUMN_NOTES.replace("`", "")))),
        Chapter("The cheapest for each scene", (Table(CHOICE_HEADINGS, build_choice_cells(study)),)),
        Chapter("Every result", (Table(ROW_HEADINGS, build_row_cells(study)),)),
        Chapter("Not evaluated, or no result", (Items(unanswered or ("nothing",)),)),
        *scenes,
    )
    headline = f"{len(study.rows)} results of {len(study.scenes)} scenes, timed and compared with a reference."
    return html("Speed against accuracy", headline, sections, summary)
