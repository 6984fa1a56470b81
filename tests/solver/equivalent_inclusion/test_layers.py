"""Layers of tissue around spheres: against ``axisymmetric`` and an independent code, one material cut up, laws, refusals."""

import json

import pytest

from geometry import Refusal, Scene, read_scene
from solver.axisymmetric.level import Axisymmetric
from solver.equivalent_inclusion.level import EquivalentInclusion
from solver.results.kinds import crossed
from tests.solver.axisymmetric.test_layers import FOLDER, on

EXPECTED = json.loads((FOLDER / "expected.json").read_text())
SCENES = {name: read_scene(FOLDER / f"{name}.toml") for name in EXPECTED}
INSIDE = [name for name, scene in SCENES.items() if scene.inclusion and crossed(scene) is None]
LEVEL = EquivalentInclusion()


def sphere(depth: float, diameter: float = 8.0, *, x: float = 0.0, y: float = 0.0, modulus: float = 3e4) -> dict[str, float]:
    """A sphere, lengths in mm."""
    return {
        "diameter": 1e-3 * diameter, "depth": 1e-3 * depth, "x": 1e-3 * x, "y": 1e-3 * y,
        "youngs_modulus": modulus, "poisson_ratio": 0.45,
    }  # fmt: skip


def within(scene: Scene, accuracy: float = 1e-2, uncertain: float = 1e-4) -> None:
    """The level's answer is as close to that of the meridian's elements as it says."""
    found, expected = LEVEL.evaluate(scene, accuracy), Axisymmetric().evaluate(scene, uncertain)
    assert found.error_estimate is not None
    for key in ("ratio", "stress_inner", "stress_outer"):
        assert abs(getattr(found, key) / getattr(expected, key) - 1) <= found.error_estimate + uncertain, key


def test_a_sphere_in_one_of_three_layers_is_as_good_as_stated():
    within(on((1.0, 2e4), (14.0, 4e3), (10.0, 2e4), inclusion=[sphere(8.0, 6.0)]))


def test_the_material_at_a_depth():
    tissue = on((1.0, 2e4), (2.0, 4e3)).tissue
    assert [tissue.material_at(1e-3 * depth).youngs_modulus for depth in (0.0, 0.5, 1.0, 2.9, 3.1, 40.0)] == [
        2e4, 2e4, 4e3, 4e3, 6e3, 6e3,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("bodies", "words"),
    [
        ([sphere(9.0)], "axisymmetric for an inclusion that an interface"),
        ([sphere(9.0, x=3.0)], "none built yet for layers of tissue but"),
        ([sphere(9.0), sphere(30.0)], "none built yet for layers of tissue but"),
    ],
)
def test_a_sphere_across_an_interface_is_refused(bodies, words):
    with pytest.raises(Refusal, match=words):
        LEVEL.evaluate(on((6.0, 2e4), inclusion=bodies))


@pytest.mark.slow
@pytest.mark.parametrize("name", INSIDE)
def test_against_an_independent_code(name):
    """NGSolve's answers (benchmarks.references.axisymmetric): the true error is within the one that is stated."""
    scene, expected = SCENES[name], EXPECTED[name]
    for accuracy in (1e-2, 1e-3):
        result, uncertain = LEVEL.evaluate(scene, accuracy), expected["relative_uncertainty"]
        for key, unit in {"ratio": "", "stress_inner": "_pa", "stress_outer": "_pa"}.items():
            assert abs(getattr(result, key) / expected[f"{key}{unit}"] - 1) <= result.error_estimate + uncertain, key
