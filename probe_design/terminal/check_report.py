"""Build the HTML report of `check`: the tables of the terminal, and sections about the scene."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from geometry.scenes.scene import Scene
from probe_design.data.noise import NOISE
from probe_design.probe_check.check import Check
from probe_design.reports.page import Chapter, Items, PageTable, Text, page
from probe_design.reports.scene_sections import asked, scene_sections
from probe_design.terminal.hardware_tables import check_table, coverage_table, explanations_table, pairs_table, sentences

if TYPE_CHECKING:
    from rich.table import Table as RichTable


def check_report(check: Check, scene: Scene, answer: dict[str, Any], tell: Callable[[str], None]) -> str:
    """Return the report as HTML.

    Args:
        check: result of the check.
        scene: the probe as designed, on the tissue of its scene.
        json_object: the JSON object of the command, with its provenance.
        tell: called with a line of text before each long step.
    """
    said = sentences(check)
    sections = [
        asked(scene),
        Chapter("Readings and predictions", below_its_title(check_table(check))),
        Chapter(
            "What would explain a deviation", (*below_its_title(explanations_table(check)), *below_its_title(pairs_table(check)))
        ),
        Chapter("What was tested", below_its_title(coverage_table(check))),
        Chapter("What it comes to", (Items(tuple(said)),)),
        *scene_sections(scene, NOISE, tell),
    ]
    return page("Check of a built probe", f"{said[0][0].upper()}{said[0][1:]}.", sections, answer)


def below_its_title(shown: RichTable) -> tuple[Text, ...] | tuple[Text, PageTable]:
    """Return a table of the terminal as title and table of the page; nothing for a table without rows."""
    if not shown.row_count:
        return ()
    columns = [[str(cell) for cell in column.cells] for column in shown.columns]
    title = f"{str(shown.title)[0].upper()}{str(shown.title)[1:]}:"
    return Text(title), PageTable(tuple(str(column.header) for column in shown.columns), tuple(zip(*columns, strict=True)))
