"""Slips of the hand: numbers that have lost their unit in Python, and keys that are almost right."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from geometry import CylinderTissue, Inclusion, InputError, Placement, Probe, Scene, read_scene, scene_from_dict, scene_to_dict
from geometry.common.errors import suggest_word
from geometry.scenes.variables import list_values
from tests.support.paths import SCENE

BLOCK = {"youngs_modulus": 1e5, "poisson_ratio": 0.3}
PROBE: dict[str, Any] = {"inner_radius": 4e-3, "outer_radius": 8e-3, "gap": 1e-4, "height": 3e-3, "inner": BLOCK, "outer": BLOCK}
TISSUE: dict[str, Any] = {"shape": "cylinder", "radius": 0.05, "depth": 0.05, **BLOCK}
BODY: dict[str, Any] = {"diameter": 8e-3, "depth": 9e-3, **BLOCK}


@pytest.mark.parametrize(
    ("model", "whole", "key", "given", "meant"),
    [
        (Probe, PROBE, "inner_radius", 4, "4 m? did you mean 0.004 or '4 mm'"),
        (Probe, PROBE, "gap", 0.3, "0.3 m? did you mean 0.0003 or '0.3 mm'"),
        (Probe, PROBE, "height", 120.0, "120 m? did you mean 0.12 or '120 mm'"),
        (CylinderTissue, TISSUE, "radius", 50, "50 m? did you mean 0.05 or '50 mm'"),
        (Inclusion, BODY, "diameter", 8, "8 m? did you mean 0.008 or '8 mm'"),
        (Inclusion, BODY, "x", -6, "-6 m? did you mean -0.006 or '-6 mm'"),
        (Placement, {}, "x", 2.0, "2 m? did you mean 0.002 or '2 mm'"),
    ],
)
def test_a_number_that_lost_its_unit_is_told(
    model: type[BaseModel], whole: dict[str, Any], key: str, given: Any, meant: str
) -> None:
    model.model_validate(whole)
    with pytest.raises(ValidationError) as refused:
        model(**{**whole, key: given})
    assert meant in str(refused.value)


def test_with_its_unit_it_is_believed() -> None:
    """And in whatever is made of the scene later on, where all numbers are SI ones."""
    wide = scene_to_dict(read_scene(SCENE))
    wide["tissue"] |= {"radius": "4 m", "depth": "3 m"}
    scene = scene_from_dict(wide)
    assert scene.tissue.radius == 4.0
    moved = scene.replace({"probe.gap": 2e-4})
    assert list_values(moved)["tissue.depth"] == 3.0
    assert Scene.model_validate(moved) == moved


@pytest.mark.parametrize(
    ("table", "wrong", "right"),
    [("probe", "inner_raduis", "inner_radius"), ("tissue", "youngs_modulo", "youngs_modulus"), ("load", "froce", "force")],
)
def test_a_key_that_is_almost_right_is_told(table: str, wrong: str, right: str) -> None:
    tables = scene_to_dict(read_scene(SCENE))
    tables[table][wrong] = "5 mm"
    with pytest.raises(InputError, match=f"did you mean '{right}'"):
        scene_from_dict(tables)


def test_a_word_like_none_of_them_is_not_guessed() -> None:
    assert suggest_word("zzz", ["gap", "height"]) == ""
    assert suggest_word(3, ["gap"]) == ""
