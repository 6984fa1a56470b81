"""The pages of keys and commands are those of the models, and describe each."""

from __future__ import annotations

import re

from docs import make_commands, make_design_keys
from docs.make_keys import PAGE, page
from geometry.scenes.scene_file import read_scene, scene_to_dict
from probe_design.populations.design_file import DESIGN_SECTIONS, Design
from tests.support.paths import EXAMPLES

ROWS = re.findall(r"^\| `(\w+)` \| (.*?) \| (.*?) \| (.*?) \|$", page(), re.M)


def test_page_is_what_the_script_prints() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run python docs/make_keys.py"


def test_page_of_design_files_is_what_its_script_prints_and_says_something_of_each_key() -> None:
    text = make_design_keys.page()
    assert make_design_keys.PAGE.read_text(encoding="utf-8") == text, "run python docs/make_design_keys.py"
    descriptions = dict(re.findall(r"^\| `(\w+)` \| (.*?) \| ", text, re.M))
    for section in DESIGN_SECTIONS:
        model = Design.model_fields[section].annotation
        assert [key for key in model.model_fields if key != "layer" and not descriptions.get(key)] == []


def test_page_of_commands_is_what_its_script_prints() -> None:
    assert make_commands.PAGE.read_text(encoding="utf-8") == make_commands.page(), "run python docs/make_commands.py"


def test_every_key_has_a_meaning_and_a_range() -> None:
    assert len(ROWS) > 60
    assert [row[0] for row in ROWS if not all(row)] == []


def test_keys_of_the_examples_are_there() -> None:
    """Among them those that could be found only through error messages: film, base, placement, diameters, orientation, layers."""
    text = page()
    for name in ("base", "film", "groove", "inner", "outer"):
        assert f"## `[probe.{name}]`" in text
    for heading in ("[[tissue.layer]]", "[[inclusion]]", "[placement]", "[contact]", "[load]"):
        assert f"## `{heading}`" in text
    named = {row[0] for row in ROWS}
    assert {"diameters", "orientation", "surface", "edge_radius", "tilt", "loss_factor"} <= named
    for path in EXAMPLES.glob("*.toml"):
        if path.name in ("scene.toml", "two-tumours.toml", "skin.toml", "paper-study.toml"):
            keys = [key for table in scene_to_dict(read_scene(path)).values() if isinstance(table, dict) for key in table]
            assert [key for key in keys if key not in named and f".{key}]" not in text] == []
