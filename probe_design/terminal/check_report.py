"""Build the HTML report of `check`: the tables of the terminal, and sections about the scene."""

from __future__ import annotations

from geometry.scenes.scene import Scene
from probe_design.data.noise import DEFAULT_NOISE
from probe_design.probe_check.check import Check
from probe_design.reporting.page import Chapter, Items, Part, Text, build_page
from probe_design.reporting.scene_sections import build_scene_section, iterate_scene_sections
from probe_design.reporting.table import Table
from probe_design.terminal.hardware_tables import (
    build_check_table,
    build_coverage_table,
    build_explanations_table,
    build_pairs_table,
    write_sentences,
)
from solver.results.evaluator import ProgressCallback


def build_check_report(check: Check, scene: Scene, json_object: dict[str, object], progress: ProgressCallback) -> str:
    """Return the report as HTML.

    Parameters
    ----------
    check
        Result of the check.
    scene
        The probe as designed, on the tissue of its scene.
    json_object
        The JSON object of the command, with its provenance.
    progress
        Called with a line of text before each long step.
    """
    summary = write_sentences(check)
    sections = [
        build_scene_section(scene),
        Chapter("Readings and predictions", show_below_title(build_check_table(check))),
        Chapter(
            "What would explain a deviation",
            (*show_below_title(build_explanations_table(check)), *show_below_title(build_pairs_table(check))),
        ),
        Chapter("What was tested", show_below_title(build_coverage_table(check))),
        Chapter("What it comes to", (Items(tuple(summary)),)),
        *iterate_scene_sections(scene, DEFAULT_NOISE, progress),
    ]
    headline = f"{summary[0][0].upper()}{summary[0][1:]}."
    return build_page("Check of a built probe", headline, sections, json_object, is_positive=check.passed)


def show_below_title(table: Table) -> tuple[Part, ...]:
    """Return a table's title and the table below it as parts of the page; nothing for a table without rows."""
    return (Text(f"{table.title[0].upper()}{table.title[1:]}:"), table) if table.rows else ()
