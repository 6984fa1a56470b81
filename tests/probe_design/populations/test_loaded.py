"""Readings over a population under a load: the linear ones at rest, mirrored, and the whole finite-strain model on the axis."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene
from geometry.scenes.scene_tables import Load
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
    return examine(scene, build_design(scene), unseen=True, pressed=(press_tissue(scene, force),))


def test_a_tiny_load_changes_nothing() -> None:
    scene = SCENE.model_copy(update={"load": Load(force=1e-3)})
    linear = examine(scene, build_design(scene), unseen=True).readings
    loaded = examine_under(1e-3).readings
    assert np.all(np.abs(loaded.signal - linear.signal) <= loaded.error + 1e-6)
    assert np.abs(loaded.signal - linear.signal).max() < 0.02 * np.abs(linear.signal).max()


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
