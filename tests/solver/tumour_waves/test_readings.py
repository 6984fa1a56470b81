"""Many tumours under many probes in closed form: against finite elements, one by one, and their derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from probe_design.data.builtin import read_typical_scenes
from solver.closed_form.designs import PROBE_PARAMETERS, build_parameters
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours
from solver.tumour_waves.moments import TumourDraws
from solver.tumour_waves.population_films import Films, ManyTumours

DEPTH = np.array([6.5e-3, 9e-3, 12e-3, 16e-3])
RADIUS = np.array([2e-3, 4e-3, 4e-3, 5e-3])
OFFSETS = np.array([0.0, 4e-3, 8e-3])


def scene(skin: float | None = None) -> Scene:
    base = read_typical_scenes()["on-axis"]
    if skin is None:
        return base
    tissue = base.tissue.model_dump(exclude_unset=True) | {
        "layer": [{"thickness": 1.4e-3, "youngs_modulus": skin, "poisson_ratio": 0.45}]
    }
    return Scene.model_validate(base.model_dump(exclude_unset=True) | {"tissue": tissue})


def population(made: Scene, modulus: float = 30e3) -> ManyTumours:
    m, tissue = len(DEPTH), made.tissue
    layers = [[layer.thickness, layer.youngs_modulus, layer.poisson_ratio] for layer in tissue.layer]
    assert tissue.shape == "cylinder"
    layers.append([tissue.depth, tissue.youngs_modulus, tissue.poisson_ratio])
    layer, zeros = np.ones(m), np.zeros(m)
    repeated = np.repeat(np.array(layers)[:, :, None], m, axis=2)
    draws = TumourDraws(RADIUS, DEPTH, zeros, zeros, modulus * layer, 0.45 * layer, repeated, True)
    shape, _ = build_parameters(made, merged=False)
    positions = np.stack([OFFSETS, 0 * OFFSETS], axis=1)
    return ManyTumours.from_draws(draws, positions, 12e-3, bonded=True, side=(1.0, 0), layer_nodes=shape.layer_nodes)


def probe(made: Scene) -> Floats:
    return build_parameters(made)[1][: len(PROBE_PARAMETERS), None]


def signals(films: Films) -> tuple[Floats, Floats]:
    """Changes of ln ratio and of ln stiffness by each tumour from each position, of the first probe."""
    alone = films.without[0][:, None]
    whole = alone + films.change[0]
    ratio = np.log(whole[..., 0] / alone[..., 0]) - np.log(whole[..., 1] / alone[..., 1])
    return ratio, np.log(whole.sum(axis=2) / alone.sum(axis=2))


@pytest.mark.slow
@pytest.mark.parametrize(("skin", "tolerance"), [(None, 0.1), (56e3, 0.2)])
def test_signals_are_those_of_finite_elements(skin: float | None, tolerance: float) -> None:
    """Of the largest over a scan: where a signal changes its sign no relative error means anything."""
    made = scene(skin)
    mine = signals(population(made).compute_films(probe(made)))
    base = EquivalentInclusion().prepare(made, 0.01)
    alone = base.films.forces.sum(axis=1)
    for p, offset in enumerate(OFFSETS):
        x, y, modulus, poisson = (np.full((4, 1), value) for value in (offset, 0.0, 30e3, 0.45))
        totals = compute_readings(base, Tumours(x, y, DEPTH[:, None], 2 * RADIUS[:, None], modulus, poisson), reflect=True).totals
        ratio = np.log(totals[:, 0] / alone[0]) - np.log(totals[:, 1] / alone[1])
        stiffness = np.log(totals.sum(axis=1) / alone.sum())
        for computed, expected in zip(mine, (ratio, stiffness), strict=True):
            assert np.all(np.abs(computed[:, p] - expected) < tolerance * np.abs(computed).max(axis=1))


def test_many_probes_are_answered_as_each_alone() -> None:
    made = scene()
    problems = population(made)
    probes = probe(made) * np.array([1.0, 1.1, 0.9])
    together = problems.compute_films(probes)
    for k in range(3):
        alone = problems.compute_films(probes[:, k : k + 1])
        for key in ("without", "change", "by_log"):
            np.testing.assert_allclose(getattr(together, key)[k], getattr(alone, key)[0], rtol=1e-9)


def test_complex_steps_give_derivatives_at_taylors_rate() -> None:
    made = scene(56e3)
    problems, sensor = population(made), probe(made)
    direction = sensor * np.array([0.3, -0.2, 0.1, 0.4, -0.3, 0.5, 0.0, -0.4, 0.0])[:, None]
    derivative = problems.compute_films(sensor + 1e-30j * direction).change.imag / 1e-30
    start = problems.compute_films(sensor).change
    left = [
        np.abs(problems.compute_films(sensor + h * direction).change - start - h * derivative).max() for h in (0.04, 0.02, 0.01)
    ]
    assert np.log2(left[0] / left[1]) == pytest.approx(2, abs=0.3)
    assert np.log2(left[1] / left[2]) == pytest.approx(2, abs=0.15)


def test_slope_by_the_tumours_modulus() -> None:
    made = scene()
    sensor = probe(made)
    lower, upper = (population(made, modulus=30e3 * np.exp(step)).compute_films(sensor).change for step in (-1e-4, 1e-4))
    np.testing.assert_allclose(population(made).compute_films(sensor).by_log, (upper - lower) / 2e-4, rtol=1e-5, atol=1e-9)
