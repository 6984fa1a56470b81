"""The report of `check`: the tables that a terminal shows, and what there is to tell of the scene, as a page."""

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
        check: what was found.
        scene: the probe as it was designed, on the tissue of its scene.
        answer: the JSON object of the verb, with its provenance.
        tell: called with a line before each long piece of work.
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
    """A terminal's table below its title as a page has them; nothing of one without rows."""
    if not shown.row_count:
        return ()
    columns = [[str(cell) for cell in column.cells] for column in shown.columns]
    title = f"{str(shown.title)[0].upper()}{str(shown.title)[1:]}:"
    return Text(title), PageTable(tuple(str(column.header) for column in shown.columns), tuple(zip(*columns, strict=True)))
