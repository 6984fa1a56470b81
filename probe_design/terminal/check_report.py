"""Build the HTML report of `check`: the tables of the terminal, and sections about the scene."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from geometry.scenes.scene import Scene
from probe_design.data.noise import DEFAULT_NOISE
from probe_design.probe_check.check import Check
from probe_design.reports.page import Chapter, Items, PageTable, Text, build_page
from probe_design.reports.scene_sections import build_scene_section, iterate_scene_sections
from probe_design.terminal.hardware_tables import (
    build_check_table,
    build_coverage_table,
    build_explanations_table,
    build_pairs_table,
    write_sentences,
)

if TYPE_CHECKING:
    from rich.table import Table as RichTable


def build_check_report(check: Check, scene: Scene, json_object: dict[str, Any], tell: Callable[[str], None]) -> str:
    """Return the report as HTML.

    Args:
        check: result of the check.
        scene: the probe as designed, on the tissue of its scene.
        json_object: the JSON object of the command, with its provenance.
        tell: called with a line of text before each long step.
    """
    summary = write_sentences(check)
    sections = [
        build_scene_section(scene),
        Chapter("Readings and predictions", convert_table(build_check_table(check))),
        Chapter(
            "What would explain a deviation",
            (*convert_table(build_explanations_table(check)), *convert_table(build_pairs_table(check))),
        ),
        Chapter("What was tested", convert_table(build_coverage_table(check))),
        Chapter("What it comes to", (Items(tuple(summary)),)),
        *iterate_scene_sections(scene, DEFAULT_NOISE, tell),
    ]
    return build_page("Check of a built probe", f"{summary[0][0].upper()}{summary[0][1:]}.", sections, json_object)


def convert_table(table: RichTable) -> tuple[Text, ...] | tuple[Text, PageTable]:
    """Return a table of the terminal as title and table of the page; nothing for a table without rows."""
    if not table.row_count:
        return ()
    columns = [[str(cell) for cell in column.cells] for column in table.columns]
    title = f"{str(table.title)[0].upper()}{str(table.title)[1:]}:"
    return Text(title), PageTable(tuple(str(column.header) for column in table.columns), tuple(zip(*columns, strict=True)))
