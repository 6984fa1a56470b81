"""By how much the walls at the gap near each other, against NGSolve, volumes and ``contact``."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from geometry import Scene, read_scene
from geometry.common.arrays import Floats
from geometry.scenes.scene_file import scene_from_dict
from solver.contact.evaluator import ContactEvaluator
from solver.contact.limits import find_gap_closure_load
from solver.planning.coarse_model import CoarseModel, GapProfile
from solver.planning.loads import CLOSURE_FORCE_SHARE, bound_wall_nearing
from tests.support.paths import REFERENCE

WALLS = json.loads((REFERENCE / "gap-walls.json").read_text())


def profile(name: str) -> GapProfile:
    return CoarseModel.from_scene(read_scene(REFERENCE / f"{name}.toml"), details=False).gap_profile


@pytest.mark.parametrize("name", WALLS)
def test_walls_near_each_other_as_an_independent_code_says(name: str) -> None:
    walls, true = profile(name), WALLS[name]
    assert true["uncertainty"] < 0.002 * true["largest"]
    assert -0.003 < walls.max_nearing / true["largest"] - 1 < 0.008
    heights = walls.heights.ravel() / read_scene(REFERENCE / f"{name}.toml").probe.inner_radius
    inside = np.array(true["heights"]) > 0.1  # nearer to the corner the coarsest mesh is rough
    nearing = np.interp(true["heights"], heights, walls.nearing.ravel())
    np.testing.assert_allclose(nearing[inside], np.array(true["nearing"])[inside], atol=0.02 * np.abs(true["nearing"]).max())


@pytest.mark.parametrize(("name", "min_bulge"), [("extremes/gap-1-um-frictionless", 0.83), ("contact/example", 0.9)])
def test_walls_bulge_between_the_ends_of_elements(name: str, min_bulge: float) -> None:
    """Looked at there alone, the gap seemed to close at a force a fifth or a tenth larger."""
    assert np.max(profile(name).nearing[:, [0, -1]]) < min_bulge * WALLS[name]["largest"]


@pytest.mark.parametrize("name", WALLS)
def test_the_largest_does_not_depend_on_the_places(name: str) -> None:
    states = CoarseModel.from_scene(read_scene(REFERENCE / f"{name}.toml"), details=False).sample.states
    assert GapProfile.from_states(states).max_nearing == pytest.approx(GapProfile.from_states(states, 1025).max_nearing, rel=1e-5)


def test_the_top_of_a_parabola_is_found_between_places() -> None:
    heights = np.linspace(0.0, 1.0, 9)
    rows: Floats = np.stack([0.3 - (heights - 0.3) ** 2, 1 - 2 * (heights - 0.8) ** 2])
    assert GapProfile(np.stack([heights, heights + 1]), rows).max_nearing == pytest.approx(1.0, rel=1e-14)
    assert GapProfile(heights[None], -heights[None] - 1).max_nearing == 0
    assert GapProfile(heights[None], heights[None]).max_nearing == 1


def on_stiff_tissue() -> Scene:
    """A nearly incompressible inner block in a tube that does not widen, both a millionth as stiff as what they stand on."""
    probe = {
        "inner_radius": "2 mm", "area_ratio": 1.0, "gap": "0.2 mm", "height": "3 mm", "base": {"rigid": True},
        "inner": {"youngs_modulus": "1e3 Pa", "poisson_ratio": 0.49999},
        "outer": {"youngs_modulus": "1e3 Pa", "poisson_ratio": 0.0},
    }  # fmt: skip
    tissue = {"shape": "cylinder", "radius": "20 mm", "depth": "20 mm", "youngs_modulus": "1e9 Pa", "poisson_ratio": 0.3}
    return scene_from_dict({"probe": probe, "tissue": tissue, "load": {"indentation": "0 mm"}})


def test_the_inner_wall_pushes_out_the_volume_that_is_pressed_in() -> None:
    """pi r^2 d = 2 pi r Int u dz of an incompressible block that is shortened by d; the tube's wall stands still."""
    scene = on_stiff_tissue()
    gap = CoarseModel.from_scene(scene, details=False).gap_profile
    volume = np.trapezoid(gap.nearing.ravel(), gap.heights.ravel())
    assert volume == pytest.approx(scene.probe.inner_radius / 2, rel=0.01)
    assert gap.heights[0, 0] == 0
    assert gap.heights[-1, -1] == pytest.approx(scene.probe.core_height, rel=1e-12)
    assert np.all(np.diff(gap.heights.ravel()) >= 0)


def test_walls_face_each_other_up_to_where_the_lower_block_ends() -> None:
    scene = read_scene(REFERENCE / "layers" / "recess-over-taller-inner.toml")
    probe = scene.probe
    assert probe.core_height > probe.tube_height
    assert CoarseModel.from_scene(scene, details=False).gap_profile.heights[-1, -1] == pytest.approx(probe.tube_height, rel=1e-12)


def cancelling() -> Scene:
    """A soft tumour twice as wide as the probe: without it the walls hardly near each other, with it twenty times as much."""
    probe = {
        "inner_radius": "4.92 mm", "area_ratio": 3.55, "gap": "11.7 um", "height": "9.77 mm", "base": {"rigid": True},
        "inner": {"youngs_modulus": "1.039e6 Pa", "poisson_ratio": 0.4},
        "outer": {"youngs_modulus": "1.019e6 Pa", "poisson_ratio": 0.499},
    }  # fmt: skip
    tissue = {"shape": "cylinder", "radius": "50 mm", "depth": "60 mm", "youngs_modulus": "7814 Pa", "poisson_ratio": 0.45}
    body = {"diameter": "20.78 mm", "depth": "13.32 mm", "youngs_modulus": "1000 Pa", "poisson_ratio": 0.45}
    return scene_from_dict({"probe": probe, "tissue": tissue, "inclusion": [body], "load": {"force": "1 mN"}})


@pytest.mark.slow
def test_where_walls_hardly_move_without_tumours_the_rule_knows_less() -> None:
    scene = cancelling()
    rough = CoarseModel.from_scene(scene, details=False)
    rule = rough.build_rule(scene)
    path = ContactEvaluator().prepare_scene(scene).paths[0]
    closure = find_gap_closure_load(path)
    assert closure is not None
    assert rule.largest_known_force < closure.force
    by_walls = replace(rule, closure=rule.closure * rough.wall_approach / rough.gap_profile.max_nearing)
    assert by_walls.largest_known_force > closure.force


def test_no_walls_count_as_still() -> None:
    scene = cancelling()
    rough = CoarseModel.from_scene(scene, details=False)
    at_most = bound_wall_nearing(rough.scene, rough.forces.sum(axis=1))
    assert rough.gap_profile.max_nearing < at_most / 12
    assert rough.wall_approach == pytest.approx(at_most / 12, rel=1e-12)
    assert rough.build_rule(scene).largest_known_force <= CLOSURE_FORCE_SHARE * rough.closure_force
