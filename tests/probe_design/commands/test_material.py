"""`probe-design material`: tables that a scene takes as they are, each number with its source."""

from __future__ import annotations

import json
import tomllib

import pytest

from geometry.scenes.scene_file import scene_from_dict
from tests.support.paths import EXAMPLES
from tests.support.program import refused, run

SCENE = (EXAMPLES / "scene.toml").read_text(encoding="utf-8")


def test_the_list_names_all() -> None:
    output = json.loads(run("material", "list", "--json").stdout)["materials"]
    assert {"elastomer", "base", "film"} == {entry["kind"] for entry in output.values()}
    assert [line.split()[0] for line in run("material", "list").stdout.splitlines()] == list(output)


@pytest.mark.parametrize(
    "words",
    [("dragon-skin-30",), ("ecoflex-00-10", "--thinner", "0.3"), ("sylgard-184", "--ratio", "20"), ("pmma",), ("pvdf-28um",)],
)
def test_what_is_shown_is_a_table_of_a_scene(words: tuple[str, ...]) -> None:
    shown = tomllib.loads(run("material", "show", *words).stdout)
    output = json.loads(run("material", "show", *words, "--json").stdout)
    ((_, table),) = shown["probe"].items()
    assert [table] == list(output["table"].values())
    assert set(output["sources"]) == set(table)
    entries = tomllib.loads(SCENE)
    scene = scene_from_dict(entries | {"probe": entries["probe"] | shown["probe"]})
    (part,) = shown["probe"]
    assert getattr(scene.probe, part).youngs_modulus == pytest.approx(output["youngs_modulus"])


def test_both_databases_and_their_licences_are_shown() -> None:
    text = run("material", "show", "ecoflex-00-30").stdout
    for said in ("97.3 kPa", "48 kPa", "CC BY 4.0", "ODbL 1.0", "compression", "tension", "factor of 2.03"):
        assert said in text


@pytest.mark.parametrize(
    "words", [("show", "liver"), ("frob",), ("show", "ecoflex-00-30", "--thinner", "0.3"), ("show", "pmma", "--thinner", "x")]
)
def test_what_is_not_there_is_refused(words: tuple[str, ...]) -> None:
    assert ": allowed: " in refused("material", *words)
