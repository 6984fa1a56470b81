"""Tumours off the axis under load: by finite strain in three dimensions, by contact's own tumour on the axis, in the limits."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np
import pytest

from geometry import Refusal, Scene, read_scene
from geometry.scenes.scene_tables import Load
from solver import curve, evaluate
from solver.contact.evaluator import ContactEvaluator
from solver.contact.path import Path
from solver.contact.pressed_tissue import PressedTissue
from solver.contact.tumour_effects import TumourResponse
from solver.contact.tumours_anywhere import MAX_X, TissueUnderLoad, prepare_tissue
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours
from tests.support.paths import EXAMPLES, REFERENCE

SCENE = read_scene(EXAMPLES / "scene.toml")
ACCURACY = 0.01  # of the pressed tissue; the linear readings are three times as accurate
PATHS = [*sorted((REFERENCE / "loaded").glob("*.json")), REFERENCE / "contact" / "off_axis.json"]
ALL_ROWS = [row for path in PATHS for row in json.loads(path.read_text())["rows"]]
# the deepest of some scenes alone: others take minutes
DEEP = "skin-0.5", "soft-core-0.5", "scan-near", "scan-beside"
ROWS = [row for row in ALL_ROWS if row["indentation_over_outer_radius"] <= (MAX_X if row["case"] in DEEP else 0.3)]
ON_AXIS = 1e-7  # m: a lateral offset that no mesh takes as on the axis


def move(scene: Scene, x: float, y: float = 0.0) -> Scene:
    body = scene.inclusion[0].model_copy(update={"x": x, "y": y})
    return scene.model_copy(update={"inclusion": (body,)})


def press(scene: Scene, force: float) -> Scene:
    return scene.model_copy(update={"load": Load(force=force)})


@cache
def prepare(probe_and_tissue: str) -> TissueUnderLoad:
    return prepare_tissue(Scene.from_tables(json.loads(probe_and_tissue)), ACCURACY)


def name(row: dict[str, Any]) -> str:
    return f"{row['case']}-{1e3 * row['force_mN']:.0f}uN-{row['scene']['inclusion'][0]['youngs_modulus'].replace(' ', '')}"


@pytest.mark.slow
@pytest.mark.parametrize("row", ROWS, ids=name)
def test_three_dimensions_at_finite_strain(row: dict[str, Any]) -> None:
    """What a tumour changes is within the stated error of solutions in three dimensions, and nearer than linear elasticity."""
    scene = Scene.from_tables(row["scene"])
    tissue = prepare(json.dumps(row["scene"] | {"inclusion": []}))
    tumours, target = Tumours.from_scene(scene), scene.target or 0
    linear = compute_readings(tissue.base, tumours, target, reflect=True, sensitive=True)
    changes = tissue.press(1e-3 * row["force_mN"]).compute_changes(linear, tumours, target)
    linear_errors = linear.log_ratio_bound[0] - tissue.base.films.bound.log_ratio, linear.sensitivity_error[0]
    keys = ("change_of_ln_ratio", "log_sensitivity")
    rows = zip(keys, changes.ratios[:, 0, 0], changes.ratio_errors[:, 0, 0], linear_errors, strict=True)
    for key, value, error, linear_error in rows:
        expected, uncertainty = row[key]["value"], row[key]["uncertainty"]
        assert abs(value - expected) <= error + linear_error + uncertainty, key


def test_light_loads_give_the_linear_result() -> None:
    scene = move(SCENE, 4e-3)
    linear = evaluate(scene, "equivalent-inclusion", 0.003)  # as accurate as the linear part of contact
    assert linear.ratio is not None
    assert linear.log_sensitivity is not None
    for force in (0.0, 1e-7, 1e-3):
        result = evaluate(press(scene, force), "contact")
        assert result.ratio == pytest.approx(linear.ratio, rel=2e-3 * force / 1e-3 + 1e-9)
        assert result.log_sensitivity == pytest.approx(linear.log_sensitivity, rel=5e-3 * force / 1e-3 + 1e-9)


def test_densities_at_rest_are_the_linear_strain_products() -> None:
    """Eq. CT.9 without load is eq. EI.1, solved on another mesh by linear elements."""
    base = EquivalentInclusion().prepare(SCENE, 0.01)
    path = prepare_path(SCENE)
    response = TumourResponse.from_equilibrium(path.model, path.light)
    r, z = np.array([0.0, 2e-3, 5.5e-3, 11e-3, 0.0]), np.array([-5e-3, -9e-3, -8e-3, -10e-3, -20e-3])
    products = base.energies.evaluate(r, z)
    tissue, pairs = SCENE.tissue, base.energies.pair_index
    bulk = tissue.youngs_modulus / 3 / (1 - 2 * tissue.poisson_ratio)
    twice_shear = tissue.youngs_modulus / (1 + tissue.poisson_ratio)
    volume, shear = response.evaluate(r, z) / response.indentation
    for film in (0, 1):
        expected = products[pairs[film, :2]].sum(axis=0), products[len(base.energies.pairs) + pairs[film, :2]].sum(axis=0)
        scale = np.abs(volume[film]) + np.abs(shear[film])
        assert np.all(np.abs(volume[film] - bulk * expected[0]) < 0.06 * scale)
        assert np.all(np.abs(shear[film] - twice_shear * expected[1]) < 0.06 * scale)


def prepare_path(scene: Scene) -> Path:
    return prepare_tissue(scene, 0.01).loaded.paths[1]


@pytest.mark.parametrize("interface", ["bonded"])
def test_beside_the_axis_is_as_on_it(interface: str) -> None:
    """On the axis the tumour is part of the mesh: all of its effects at finite strain are computed."""
    scene = press(SCENE.replace({"contact.interface": interface}), 0.05)
    on_axis, beside = (evaluate(move(scene, x), "contact") for x in (0.0, ON_AXIS))
    assert on_axis.ratio is not None
    assert on_axis.log_sensitivity is not None
    assert beside.ratio is not None
    assert beside.error_estimate is not None
    assert beside.ratio == pytest.approx(on_axis.ratio, rel=beside.error_estimate + (on_axis.error_estimate or 0.0))
    assert beside.ratio == pytest.approx(on_axis.ratio, rel=2e-3)
    assert beside.log_sensitivity == pytest.approx(on_axis.log_sensitivity, rel=0.02)
    linear = evaluate(move(scene, ON_AXIS), "equivalent-inclusion").log_sensitivity
    assert linear is not None
    assert abs(linear / on_axis.log_sensitivity - 1) > 0.05  # what the load changes is more than what this test allows


def test_mirrored_and_turned_tumours_change_the_same() -> None:
    results = [evaluate(press(move(SCENE, x, y), 0.03), "contact") for x, y in ((3e-3, 4e-3), (-3e-3, 4e-3), (5e-3, 0.0))]
    for result in results[1:]:
        assert result.ratio == pytest.approx(results[0].ratio, rel=1e-9)
        assert result.log_sensitivity == pytest.approx(results[0].log_sensitivity, rel=1e-8)


def test_a_given_indentation_is_the_force_that_it_takes() -> None:
    scene = move(SCENE, 4e-3)
    by_force = evaluate(press(scene, 0.03), "contact")
    assert by_force.stiffness is not None
    by_depth = evaluate(scene.model_copy(update={"load": Load(indentation=0.03 / by_force.stiffness)}), "contact")
    assert by_depth.ratio == pytest.approx(by_force.ratio, rel=1e-4)
    assert by_depth.stiffness == pytest.approx(by_force.stiffness, rel=1e-3)


def test_several_tumours_add_to_first_order() -> None:
    """Two far from each other change what both change alone, up to the product of their effects."""
    first, second = (move(SCENE, x).inclusion[0] for x in (12e-3, -12e-3))
    scenes = [press(SCENE.model_copy(update={"inclusion": bodies}), 0.03) for bodies in ((first, second), (first,), (second,))]
    bare = press(SCENE.model_copy(update={"inclusion": ()}), 0.03)
    both, *alone = (change_of(scene) for scene in scenes)
    assert np.abs(both - sum(alone)).max() < 0.05 * np.abs(both).max()
    assert ContactEvaluator().refusal(bare) is None


def change_of(scene: Scene) -> np.ndarray:
    pressed: PressedTissue = ContactEvaluator().press_tissue(scene, 0.01)
    tumours = Tumours.from_scene(scene)
    return pressed.compute_changes(compute_readings(pressed.base, tumours), tumours).changes[0, 0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"load.force": 0.4}, r"load\.force = 0\.4 N: allowed: up to 0\.3\d+ N for contact"),
        ({"load.force": 20.0}, r"load\.force = 20 N: allowed: up to 0\.3\d+ N for contact"),
        ({"contact.interface": "unilateral", "load.force": 0.01}, "one inclusion, a sphere on the axis of an upright probe"),
        ({"contact.edge_radius": 1e-4, "load.force": 0.01}, "one inclusion, a sphere on the axis of an upright probe"),
    ],
)
def test_what_is_not_known_is_refused_with_what_is(changes: dict[str, object], message: str) -> None:
    with pytest.raises(Refusal, match=message):
        evaluate(move(SCENE, 4e-3).replace(changes), "contact")


@pytest.mark.slow
def test_auto_presses_tumours_off_the_axis_beyond_linear_elasticity() -> None:
    result = evaluate(press(move(SCENE, 4e-3), 0.05), accuracy=0.02)
    assert result.evaluator == "contact"
    assert evaluate(press(move(SCENE, 4e-3), 0.001), accuracy=0.02).evaluator == "equivalent-inclusion"


@pytest.mark.slow
def test_a_curve_of_an_ellipsoid_beyond_linear_elasticity_is_that_of_its_evaluations() -> None:
    """Not by linear elasticity in three dimensions, which a curve of ellipsoids took at any load."""
    body = SCENE.inclusion[0].model_copy(update={"diameter": None, "diameters": (6e-3, 5e-3, 4e-3), "x": 3e-3})
    scene = press(SCENE.model_copy(update={"inclusion": (body,)}), 0.1)
    moduli = np.array([15e3, 60e3])
    result = curve(scene, moduli, 0.05)
    single = [evaluate(scene.replace({"inclusion[0].youngs_modulus": float(modulus)}), accuracy=0.05) for modulus in moduli]
    assert result.evaluator == "contact"
    assert result.ratio == pytest.approx([item.ratio for item in single], rel=1e-9)
    assert result.log_sensitivity == pytest.approx([item.log_sensitivity for item in single], rel=1e-6)
