"""The probe without its tumour, from the mesh that has it, against meshes of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from geometry import Scene, read_scene
from geometry.scenes.scene import Layer
from solver import evaluate, evaluate_many
from solver.axisymmetric.level import Axisymmetric
from solver.axisymmetric.refinement import LEVELS
from solver.axisymmetric.sample import PressedBlocks, pressed_alone, sample
from solver.axisymmetric.sections import sections
from solver.linalg.workspace import Workspace, using
from solver.planning.coarse_model import CoarseModel, without_tumours
from tests.support.paths import REFERENCE
from tests.support.references import named

FORCES, CLOSURE = 0.01, 0.1


def fine(scene: Scene) -> PressedBlocks:
    """A mesh of order 6 for the probe alone."""
    bare = without_tumours(scene)
    of = sections(bare)
    return PressedBlocks.of(sample(of.section, of, bare, LEVELS[3]).states)


def layered(thickness: float) -> Scene:
    """A stiff layer down to a depth, m: above the sphere, across it or below it; sphere and layers differ in Poisson's ratio."""
    scene = named("axisymmetric", "shallow").scene
    skin = Layer(thickness=thickness, youngs_modulus=3 * scene.tissue.youngs_modulus, poisson_ratio=0.45)
    return scene.model_copy(update={"tissue": scene.tissue.model_copy(update={"layer": (skin,)})})


def body(scene: Scene, **values: Any) -> Scene:
    return scene.model_copy(update={"inclusion": (scene.inclusion[0].model_copy(update=values),)})


BODY = named("axisymmetric", "shallow").scene.inclusion[0]
TOP = BODY.depth - (BODY.diameter or 0.0) / 2
SCENES = [
    *(named("axisymmetric", name).scene for name in ("shallow", "nearly-incompressible", "soft-cyst", "published-materials")),
    body(named("axisymmetric", "shallow").scene, youngs_modulus=1e9),
    body(named("axisymmetric", "shallow").scene, youngs_modulus=1e-2, poisson_ratio=0.4999),
    *(layered(depth) for depth in (TOP / 2, BODY.depth, BODY.depth + 0.7 * (BODY.diameter or 0.0))),
]


@pytest.mark.parametrize("scene", SCENES)
def test_tissue_in_the_tumours_place_is_the_probe_alone(scene: Scene) -> None:
    found = Axisymmetric().converged(scene, 0.01).sample.states
    pressed, true = PressedBlocks.without_inclusion(found), fine(scene)
    assert pressed is not None
    assert pressed.totals == pytest.approx(true.totals, rel=FORCES)
    assert pressed.closure == pytest.approx(true.closure, rel=CLOSURE)
    assert np.abs(found.forces.sum(axis=1) / true.totals - 1).max() > FORCES  # with it they are not


def test_a_mesh_that_is_too_coarse_without_its_tumour_says_so() -> None:
    """A probe a hundredth as wide as the tumour close below it: its own mesh would be far finer beneath the blocks."""
    scene = read_scene(REFERENCE / "extremes" / "micro-probe-diameter-50-mm-cover-10-um.toml")
    assert pressed_alone(Axisymmetric().converged(scene, 0.01).sample.states) is None


@pytest.mark.parametrize("path", ["extremes/gap-1-um-frictionless", "axisymmetric/homogeneous"])
def test_walls_are_looked_at_between_the_elements_corners(path: str) -> None:
    """There they near each other most: by the corners alone the gap seemed to close at a force a tenth or a fifth larger."""
    scene = read_scene(REFERENCE / f"{path}.toml")
    assert CoarseModel.of(scene, details=False).closure == pytest.approx(fine(scene).closure, rel=0.05)


def test_loads_of_a_new_design_are_judged_without_another_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> CoarseModel:
        raise AssertionError("a mesh of its own")

    monkeypatch.setattr(CoarseModel, "of", refused)
    scene = named("axisymmetric", "shallow").scene
    alone = evaluate(scene, "axisymmetric", 0.005).linear_limit_load
    (together,) = evaluate_many([scene], "axisymmetric", 0.005)
    assert alone is not None
    assert together.linear_limit_load == alone  # type: ignore[union-attr]


def test_moduli_of_one_tumour_share_a_rule_and_no_answer_depends_on_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bit for bit the same, whichever was asked first."""
    scenes = [body(named("axisymmetric", "shallow").scene, youngs_modulus=modulus) for modulus in (3e4, 4e5)]
    solved: list[object] = []
    found = PressedBlocks.without_inclusion
    monkeypatch.setattr(PressedBlocks, "without_inclusion", lambda states: solved.append(states) or found(states))
    limits = []
    for order in (scenes, scenes[::-1]):
        with using(Workspace()):
            limits.append({one: evaluate(one, "axisymmetric", 0.005).linear_limit_load for one in order})
    assert limits[0] == limits[1]
    assert len(solved) == 2
