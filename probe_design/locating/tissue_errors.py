"""Estimate what is off where the tissue is not known: readings without tumours, and what tumours change.

Each number of the tissue that differs between patients moves both, to first order, by its standard deviation s_j times their
derivatives. What it moves of the readings without tumours is common to all readings, as their gain is; what it moves of the
signals is, nearly, one factor on all of them, a of LO.1:

    g^2 = sum_j (s_j t_j)^2,   f^2 = sum_j s_j^2 |ds/d ln n_j|^2 / |s|^2                                  (LO.4)

with the numbers n_j, the derivatives t_j of ln ratio or ln stiffness without tumours, and signals s of tumours of the population
at several distances.
"""

from __future__ import annotations

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.scene import Scene
from probe_design.populations.film_totals import stack_totals
from probe_design.populations.population import TUMOUR_PARAMETERS, ScenePopulation
from solver.inclusions.tumours import Tumours
from solver.reading_tables.effect_samplers import LinearEffects

SAMPLES, SEED = 32, 5  # tumours, of which those that fit all tissues count
OFFSETS_OUTER_RADII = (0.0, 0.5, 1.0)  # outer radii: where signals are large


def estimate_tissue_errors(population: ScenePopulation) -> tuple[Floats, Floats]:
    """Return g and f of LO.4 for ln ratio and ln stiffness, shape (2,) each; 0 in a known tissue.

    The derivatives are those of linear elasticity, to first order in the tumours, over one standard deviation to either side.

    Raises
    ------
    InputError
        No tumour of the population fits the tissue at both ends.
    Refusal
        ``equivalent-inclusion`` cannot model a tissue.
    """
    open_names = [name for name in population.tissue_parameters if not population.ranges[name].is_single]
    if not open_names:
        return np.zeros(2), np.zeros(2)
    pairs = [[_shift(population, name, sign) for sign in (-1, 1)] for name in open_names]
    bodies = _draw_bodies(population, [scene for pair in pairs for scene in pair])
    if not len(bodies):
        allowed = "ranges of the tissue within which tumours fit at both ends"
        raise InputError("population", Words("no tumour fits all tissues"), allowed)
    middle = _read(population.middle, bodies, population.poisson_ratio)[1]
    readings, signals = np.zeros(2), np.zeros(2)
    for pair in pairs:
        (low_blank, low), (high_blank, high) = (_read(scene, bodies, population.poisson_ratio) for scene in pair)
        readings += ((high_blank - low_blank) / 2) ** 2
        signals += (((high - low) / 2) ** 2).mean(axis=0) / (middle**2).mean(axis=0)
    return np.sqrt(readings), np.sqrt(signals)


def _shift(population: ScenePopulation, name: str, sign: int) -> Scene:
    """Return the tissue with one number a standard deviation of its logarithm off the middle."""
    numbers = {key: population.ranges[key].middle for key in population.tissue_parameters}
    sd = float(np.std(np.log(population.ranges[name].compute_quantiles(np.linspace(0, 1, 101)))))
    return population.build_tissue_scene(numbers | {name: numbers[name] * float(np.exp(sign * sd))})


def _draw_bodies(population: ScenePopulation, scenes: list[Scene]) -> Floats:
    """Return tumours that fit all tissues, columns as in ``TUMOUR_PARAMETERS``, shape (n, 4)."""
    fractions = np.random.default_rng(SEED).random((len(TUMOUR_PARAMETERS), 8 * SAMPLES))
    columns = [population.ranges[key].compute_quantiles(row) for key, row in zip(TUMOUR_PARAMETERS, fractions, strict=True)]
    bodies = np.stack(columns, axis=1)
    misfits = [reason for scene in scenes for reason in population.find_misfits(scene, bodies).values()]
    return np.asarray(bodies[~np.any(misfits, axis=0)][:SAMPLES])


def _read(scene: Scene, bodies: Floats, poisson_ratio: float) -> tuple[Floats, Floats]:
    """Return ln ratio and ln stiffness without tumours, (2,), and what tumours change at several distances, (n, 2)."""
    sampler = LinearEffects(scene)
    totals = np.abs(stack_totals(scene, sampler.films))
    offsets = np.array(OFFSETS_OUTER_RADII) * scene.probe.tube_radius
    depth, diameter, modulus = bodies[:, :3].T
    columns = np.broadcast_arrays(offsets, 0.0, depth[:, None], diameter[:, None], modulus[:, None], poisson_ratio)
    effects = sampler.compute_effects(Tumours(*(np.ravel(column) for column in columns)), reflect=False)
    signals = np.stack([np.log1p(effects[:, 0]) - np.log1p(effects[:, 1]), np.log1p(effects[:, 2])], axis=-1)
    return np.log([totals[-2] / totals[-1], totals[:2].sum()]), signals
