"""Derivatives under load by numbers of the scene, against differences of evaluations of other scenes and of other loads."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from geometry import Scene, read_scene
from geometry.common.arrays import Floats
from geometry.scenes.film import Film
from geometry.scenes.variables import list_values
from solver.axisymmetric.gradients import compute_gradients
from solver.contact.design_derivatives import LoadedDerivatives, compute_loaded_derivatives
from solver.contact.evaluator import ContactEvaluator
from solver.contact.loaded_scene import LoadedScene
from tests.support.paths import SCENE

FORCE, ACCURACY = 0.08, 0.01  # N: the charges' ratio is then 4 % from its linear limit
COARSE_ACCURACY = 0.03  # of evaluations: a finer mesh on one side of a difference would add its own
# with the tolerance of each, of its largest derivative: below what the load adds, 0.05, 0.03 and 0.03
TOLERANCES = {"probe.gap": 0.03, "probe.film.bond_to_base.youngs_modulus": 0.01, "probe.outer.poisson_ratio": 0.01}
NUMBERS = tuple(TOLERANCES)


@lru_cache
def build_bare() -> Scene:
    """The examples' probe, with its films between two tapes, on tissue without a tumour."""
    film = Film.model_validate({"bond_to_base": "tape-50um", "bond_to_block": "tape-50um"})
    scene = read_scene(SCENE)
    probe = scene.probe.model_copy(update={"film": film})
    return scene.model_copy(update={"probe": probe, "inclusion": ()}).replace({"load.force": FORCE})


@lru_cache
def press() -> tuple[LoadedScene, LoadedDerivatives]:
    loaded = LoadedScene.from_scene(build_bare(), ACCURACY)
    return loaded, compute_loaded_derivatives(loaded, NUMBERS)


def compute_logs(scene: Scene) -> Floats:
    """ln of stresses' and charges' ratios and of both charges by ``evaluate``."""
    result = ContactEvaluator().evaluate(scene, COARSE_ACCURACY)
    values = (result.ratio, result.charge_ratio, result.charge_inner, result.charge_outer)
    assert None not in values
    return np.log(np.abs(np.array(values, dtype=float)))


@pytest.mark.parametrize("name", NUMBERS)
def test_derivatives_are_those_of_evaluations(name: str) -> None:
    scene, value = build_bare(), list_values(build_bare())[name]
    step = 0.1 * (0.5 - value if name.endswith("poisson_ratio") else value)
    low, high = (compute_logs(scene.replace({name: value + h})) for h in (-step, step))
    loaded, derivatives = press()
    exact = compute_gradients(scene, loaded.linear.sample)
    column = exact.variables.index(name)
    keys = ("ratio", "charge_ratio", "charge_inner", "charge_outer")
    linear = np.array([exact.derivatives[key][0, column] / exact.values[key][0] for key in keys])
    stress_inner, stress_outer, inner, outer = derivatives.growths[NUMBERS.index(name)]
    added = np.array([stress_inner - stress_outer, inner - outer, inner, outer])
    scale = np.abs(linear + added).max()
    difference, tolerance = (high - low) / (2 * step), TOLERANCES[name] * scale
    assert difference == pytest.approx(linear + added, abs=tolerance)
    assert np.abs(difference - linear).max() > 2 * tolerance  # the load matters: without what it adds, this is off


def test_charges_are_proportional_to_d() -> None:
    """The sum of x d ln Q / dx over all d is 1 under any load and about any preload: the load adds nothing to it."""
    loaded = LoadedScene.from_scene(build_bare().replace({"load.force": 0.1, "load.preload": 0.03}), ACCURACY)
    names = ("probe.film.d31", "probe.film.d32", "probe.film.d33")
    added = [list_values(loaded.scene)[name] for name in names] * compute_loaded_derivatives(loaded, names).growths.T
    assert added.sum(axis=1) == pytest.approx(np.zeros(4), abs=1e-6)
    assert np.abs(added[2:]).max() > 1e-3
    assert added[:2] == pytest.approx(np.zeros((2, 3)), abs=1e-6)  # forces do not depend on d


def test_moduli_and_force_scale_together() -> None:
    """Of dimensionless ratios, the derivatives by ln of all moduli and by ln of the force sum to zero."""
    loaded, derivatives = press()
    names = [name for name in list_values(loaded.scene) if name.endswith("youngs_modulus")]
    values = np.array([list_values(loaded.scene)[name] for name in names])
    growths = compute_loaded_derivatives(loaded, names).growths
    assert values @ growths + derivatives.by_force == pytest.approx(np.zeros(4), abs=1e-4)
    assert abs(derivatives.by_force[2] - derivatives.by_force[3]) > 0.02
    heavier = compute_logs(build_bare().replace({"load.force": 1.02 * FORCE}))
    lighter = compute_logs(build_bare().replace({"load.force": 0.98 * FORCE}))
    inner, outer = derivatives.by_force[2:]
    assert (heavier - lighter)[1] / np.log(1.02 / 0.98) == pytest.approx(inner - outer, abs=5e-3)


def test_light_loads_add_nothing() -> None:
    loaded = LoadedScene.from_scene(build_bare().replace({"load.force": 1e-4}), ACCURACY)
    derivatives = compute_loaded_derivatives(loaded, NUMBERS)
    values = np.array([list_values(build_bare())[name] for name in NUMBERS])
    assert values[:, None] * derivatives.growths == pytest.approx(np.zeros((len(NUMBERS), 4)), abs=2e-2)
    assert derivatives.by_force == pytest.approx(np.zeros(4), abs=1e-3)
