"""`probe-design tissue`: tables that a scene takes as they are, each number with its source."""

from __future__ import annotations

import json
import tomllib

import pytest

from geometry.scenes.scene_file import scene_from_dict
from tests.support.paths import EXAMPLES
from tests.support.program import refused, run

NAMES = ("breast", "forearm", "phantom")


def test_the_list_names_all() -> None:
    assert list(json.loads(run("tissue", "list", "--json").stdout)["tissues"]) == list(NAMES)
    assert [line.split()[0] for line in run("tissue", "list").stdout.splitlines()] == list(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_what_is_shown_is_a_scene_s_tissue(name: str) -> None:
    shown, output = tomllib.loads(run("tissue", "show", name).stdout), json.loads(run("tissue", "show", name, "--json").stdout)
    assert shown["tissue"].get("layer", []) == output["tissue"]["layer"]
    scene = scene_from_dict(tomllib.loads((EXAMPLES / "scene.toml").read_text()) | shown)
    assert len(scene.tissue.layer) == len(output["tissue"]["layer"])
    assert set(output["sources"]) == {
        *(f"tissue.{key}" for key in ("youngs_modulus", "poisson_ratio")),
        *(f"tissue.layer[{k}].{key}" for k, layer in enumerate(output["tissue"]["layer"]) for key in layer),
    }


@pytest.mark.parametrize("name", NAMES)
def test_every_number_is_published_with_its_scatter_or_said_to_be_assumed(name: str) -> None:
    for source in json.loads(run("tissue", "show", name, "--json").stdout)["sources"].values():
        published = "+-" in source or "one volunteer" in source
        assert published or source.startswith("assumed: ")


def test_the_breast_is_the_one_of_the_example() -> None:
    shown, example = tomllib.loads(run("tissue", "show", "breast").stdout), tomllib.loads((EXAMPLES / "skin.toml").read_text())
    assert shown["tissue"]["layer"] == example["tissue"]["layer"]
    assert shown["tissue"]["youngs_modulus"] == example["tissue"]["youngs_modulus"]


@pytest.mark.parametrize("words", [("show", "liver"), ("frob",)])
def test_what_is_not_there_is_refused(words: tuple[str, ...]) -> None:
    assert ": allowed: " in refused("tissue", *words)
