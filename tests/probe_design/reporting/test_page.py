"""The report in a browser: whole at a phone's and a desk's width, its bodies drawn, nothing fetched, nothing complained of."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from geometry import read_scene
from geometry.provenance.block import build_provenance
from geometry.provenance.texts import read_block
from probe_design.reporting.bodies import build_bodies
from probe_design.reporting.page import Chapter, Code, Items, Part, Picture, Text, TurningView, build_page
from probe_design.reporting.table import Table
from tests.support.browser import darkened, shown
from tests.support.paths import EXAMPLES, SCENE

ODD = "<script>alert(1)</script> & \"quotes\" 'and' {{ braces }}"
LONG = "a_very_long_name_without_any_blank_" * 8


def written(folder: Path, *parts: Part) -> Path:
    answer = {"ratio": 0.5, "note": ODD, "provenance": build_provenance(read_scene(SCENE))}
    path = folder / "report.html"
    path.write_text(build_page(f"Report {ODD}", LONG, [Chapter(ODD, parts)], answer), encoding="utf-8")
    return path


@pytest.fixture
def report(tmp_path: Path) -> Path:
    wide = Table(tuple(f"heading {k}" for k in range(15)), (tuple("1.2345678" for _ in range(15)), (LONG, *"abcdefghijklmn")))
    view = TurningView(build_bodies(read_scene(EXAMPLES / "two-tumours.toml")), "the probe")
    picture = Picture.from_figure(Figure(figsize=(16.0, 9.0)), "an empty picture that is wider than the page")
    return written(tmp_path, Text(ODD), Text(LONG), Code(LONG), Items((ODD, "design.toml"), links=True), wide, view, picture)


def test_texts_are_texts_and_nothing_is_fetched(report: Path) -> None:
    text = report.read_text(encoding="utf-8")
    assert "<script>alert" not in text
    assert text.count("&lt;script&gt;alert(1)&lt;/script&gt;") >= 4
    assert '<meta name="viewport" content="width=device-width' in text
    assert re.findall(r"""(?:src|href)\s*=\s*["'](?!data:|design\.toml|&lt;)[^"']*""", text) == []
    assert "http" not in text


def test_control_codes_are_shown_and_not_obeyed(tmp_path: Path) -> None:
    text = written(tmp_path, Text("a\x1b[31m\x9b\x07b\n\tc")).read_text(encoding="utf-8")
    assert "a\\x1b[31m\\x9b\\x07b\n\tc" in text


def test_the_answer_is_inside(report: Path) -> None:
    block, answer = read_block(report)
    assert answer == {"ratio": 0.5, "note": ODD}
    assert block == json.loads(json.dumps(build_provenance(read_scene(SCENE))))


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1280])
def test_a_page_in_a_browser(report: Path, width: int, tmp_path: Path) -> None:
    page = shown(report, width, tmp_path)
    assert page.console == []
    assert int(page.attributes["width"]) == width
    assert int(page.attributes["scroll"]) <= width
    assert page.attributes["clipped"] == ""
    scrolled = str(int(width == 390))  # the broad picture, whose texts would be too small; wide tables are stacked
    assert (page.attributes["scrolled"], page.attributes["reached"]) == (scrolled, scrolled)
    assert int(page.attributes["drawn"]) > 3000  # pixels that are not background
    assert page.attributes["tables"] == page.attributes["buttons"] == "2"


@pytest.mark.slow
def test_no_part_of_a_page_is_dark_where_pictures_are_white(report: Path, tmp_path: Path) -> None:
    assert imread(darkened(report, tmp_path))[:3, :3, :3].min() == 1.0
