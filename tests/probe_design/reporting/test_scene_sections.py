"""What a report states of a scene with a tumour on the axis and off it."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from geometry import Scene, read_scene
from geometry.scenes.scene_file import scene_to_toml
from geometry.scenes.variables import list_values
from probe_design.reporting import scene_sections as sections_module
from probe_design.reporting.page import Text, build_page
from probe_design.reporting.table import Table
from solver import evaluate
from tests.support.browser import shown
from tests.support.paths import EXAMPLES, SCENE


def table(scene: Scene) -> dict[str, tuple[float, ...]]:
    rows = next(part for part in sections_module._build_sensitivities(scene) if isinstance(part, Table)).rows
    return {name: tuple(map(float, cells)) for name, *cells in rows}


def test_sensitivities_are_those_of_the_level() -> None:
    """A central difference over 2 %, by the evaluator itself."""
    scene, key = read_scene(SCENE), "probe.outer.youngs_modulus"
    size = list_values(scene)[key]
    upper, lower = (evaluate(scene.replace({key: factor * size}), "axisymmetric", 1e-3) for factor in (1.01, 0.99))
    assert upper.ratio is not None
    assert lower.ratio is not None
    assert table(scene)[key][0] == pytest.approx(100 * (upper.ratio - lower.ratio) / (upper.ratio + lower.ratio), rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["scene.toml", "two-tumours.toml"])
def test_a_whole_report_in_a_browser(name: str, tmp_path: Path) -> None:
    scene = read_scene(EXAMPLES / name)
    sections = [sections_module.build_scene_section(scene), *sections_module.iterate_scene_sections(scene, 0.05)]
    refused = [
        (section.title, part.text)
        for section in sections
        for part in section.parts
        if isinstance(part, Text) and "Not available" in part.text
    ]
    assert refused == []
    answer = evaluate(scene, accuracy=0.05, linear=True).as_dict()
    path = tmp_path / "report.html"
    path.write_text(build_page("Report", "As it is.", sections, answer), encoding="utf-8")
    for width in (390, 1280):
        browser_page = shown(path, width, tmp_path)
        assert browser_page.console == []
        assert (browser_page.attributes["clipped"], browser_page.attributes["broken"]) == ("", "0")
        assert int(browser_page.attributes["drawn"]) > 3000


def test_what_cannot_be_told_says_why() -> None:
    scene = read_scene(SCENE).model_copy(update={"inclusion": ()})
    section = next(
        section_item
        for section_item in sections_module.iterate_scene_sections(scene, 0.05)
        if section_item.title.startswith("Tumours detected")
    )
    assert [type(part) for part in section.parts] == [Text]
    assert replace(section, parts=()).title


def test_moduli_of_a_scene_are_shown_as_people_write_them() -> None:
    text = scene_to_toml(read_scene(SCENE))
    assert all(f'youngs_modulus = "{modulus}"' in text for modulus in ("1 MPa", "80 kPa", "6 kPa", "30 kPa"))
    assert Scene.from_dict(tomllib.loads(text)) == read_scene(SCENE)
