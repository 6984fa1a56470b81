"""Readings over a population under a load: the linear ones at rest, mirrored, and the whole finite-strain model on the axis."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene
from geometry.scenes.scene_tables import Load
from probe_design.design_search.population_objective import PopulationObjective
from probe_design.design_search.variables import read_vector
from probe_design.populations.design_file import Design, design_from_dict
from probe_design.populations.examination import Examination, examine
from probe_design.populations.loaded_scan import press_tissue
from solver import evaluate

SCENE = read_scene(Path(__file__).parents[3] / "examples" / "scene.toml")
POSITIONS = [-6e-3, 0.0, 6e-3]


def build_design(scene: Scene = SCENE) -> Design:
    tables = {"protocol": {"positions": POSITIONS, "stiffness": True}, "noise": {"white": 0.01, "stiffness_white": 0.01}}
    return design_from_dict({"scene": scene, **tables})


def examine_under(force: float) -> Examination:
    scene = SCENE.model_copy(update={"load": Load(force=force)})
    return examine(scene, build_design(scene), unseen=True, pressed=((press_tissue(scene, force),),))


def test_a_tiny_load_changes_nothing() -> None:
    scene = SCENE.model_copy(update={"load": Load(force=1e-3)})
    linear = examine(scene, build_design(scene), unseen=True).readings
    loaded = examine_under(1e-3).readings
    assert np.all(np.abs(loaded.signal - linear.signal) <= loaded.error + 1e-6)
    assert np.abs(loaded.signal - linear.signal).max() < 0.02 * np.abs(linear.signal).max()


@pytest.mark.slow
@pytest.mark.parametrize("force", [0.1])
def test_on_the_axis_a_population_of_one_reads_as_the_whole_model(force: float) -> None:
    """``contact`` has the sphere in its mesh; a population has first-order effects about tissue without it."""
    examined = examine_under(force)
    readings, places = examined.readings, len(POSITIONS)
    assert examined.evaluator == "contact"
    with_tumour = SCENE.model_copy(update={"load": Load(force=force)})
    ratios = [
        evaluate(scene, evaluator="contact", accuracy=0.01).ratio
        for scene in (with_tumour, with_tumour.model_copy(update={"inclusion": ()}))
    ]
    signal = math.log(ratios[0] / ratios[1])
    assert abs(readings.signal[0, 1] - signal) <= readings.error[0, 1] + 1e-4
    assert abs(readings.signal[0, 1] - signal) < 0.1 * abs(signal)
    # both sides of the tumour read the same
    np.testing.assert_allclose(readings.signal[0, 0], readings.signal[0, 2], rtol=1e-9)
    assert readings.signal.shape == (1, 2 * places)


def test_two_equal_loads_are_one_load_with_less_noise() -> None:
    """Two independent readings of one signal are one with noise / sqrt(2), by every measure, for formulas and under load."""
    force, scene = 0.1, SCENE.model_copy(update={"load": Load(force=0.1)})
    white, pressed = 0.02, (press_tissue(scene, force),)
    tables = {"positions": POSITIONS, "stiffness": True}
    twice = design_from_dict({"scene": scene, "protocol": tables | {"loads": [force, force]}, **build_noise(white)})
    once = design_from_dict({"scene": scene, "protocol": tables, **build_noise(white / math.sqrt(2))})
    for given in ({}, {"unseen": True, "pressed": (pressed,)}):
        repeated = given | ({"pressed": (pressed, pressed)} if given else {})
        both = [examine(scene, design, **item).evaluate(design) for design, item in ((twice, repeated), (once, given))]
        for kind in ("detection", "information"):
            assert both[0].means[kind] == pytest.approx(both[1].means[kind], rel=1e-6)
        np.testing.assert_allclose(both[0].contrast_sd, both[1].contrast_sd, rtol=1e-6)


def build_noise(white: float) -> dict[str, dict[str, float]]:
    return {"noise": {"white": white, "stiffness_white": white, "charge": 0.0, "gain": 0.03, "stiffness_gain": 0.03}}


def test_a_search_weighs_loads_as_a_verification_does() -> None:
    """The objective of the closed form is the bound of a known tumour; charges are those of each load."""
    values = []
    for loads, charge in (((2e-3, 2e-3), 2e-14), ((2e-3,), 2e-14 / math.sqrt(2))):
        protocol = {"positions": POSITIONS, "stiffness": False, "loads": loads}
        tables = {"protocol": protocol, "noise": {"white": 1e-9, "charge": charge}}
        design = design_from_dict({"scene": SCENE, **tables})
        objective = PopulationObjective.from_design(design, SCENE.probe.tube_radius)
        x = read_vector(SCENE)[:, None]
        values.append(objective.values(x, (0.45, 0.45))[0][0])
    assert values[0] == pytest.approx(values[1], rel=1e-6)
    assert 0.05 < values[0] < 0.999


@pytest.mark.parametrize(
    ("tables", "allowed"),
    [
        ({"limits": {"force": 0.1}}, "the largest limits.force"),
        ({"variables": {"force": {"choices": [0.1]}}}, "the largest variables.force"),
        ({"protocol": {"loads": [0.0]}}, "loads"),
        ({"protocol": {"loads": [0.1] * 7}}, "up to 6"),
    ],
)
def test_contradictory_loads_are_refused(tables: dict[str, dict[str, object]], allowed: str) -> None:
    with pytest.raises(InputError, match=allowed):
        design_from_dict({"scene": SCENE, "protocol": {"loads": [0.1, 0.3]}, **tables})
