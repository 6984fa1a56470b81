"""Compute what the unknown numbers of the tissue change: readings without tumours, and the signals of tumours.

Each number n_j of the tissue that differs between patients is a common error of all readings, eq. LO.5: over its standard
deviation s_j of ln n_j it moves the readings without tumours by a_j and, to first order, all signals s by one factor b_j,

    a_j = s_j dt/d ln n_j,   b_j = s_j (ds/d ln n_j . s) / |s|^2,   f^2 = sum_j |s_j ds/d ln n_j - b_j s|^2 / |s|^2      (LO.4)

with the readings t without tumours, and signals s of tumours of the population at several distances. What the factor leaves of
the signals' change, f, counts as another common error of theirs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.scene import Scene
from probe_design.locating.common_errors import CommonErrors
from probe_design.locating.scan_loads import ScanLoads, TumourFree
from probe_design.populations.film_totals import stack_totals
from probe_design.populations.population import TUMOUR_PARAMETERS, ScenePopulation
from solver.inclusions.tumours import Tumours
from solver.reading_tables.effect_samplers import LinearEffects, LoadedEffects

SAMPLES, SEED = 32, 5  # tumours, of which those that fit all tissues count
OFFSETS_OUTER_RADII = (0.0, 0.5, 1.0)  # outer radii: where signals are large


@dataclass(frozen=True)
class TissueEffects:
    """What is not known of the tissue.

    Attributes
    ----------
    middles
        Number in the middle of its range, SI units, by its name in ``ScenePopulation.ranges``.
    errors
        The same numbers as common errors, and f of LO.4.
    """

    middles: dict[str, float]
    errors: CommonErrors

    @classmethod
    def from_population(cls, population: ScenePopulation, loads: ScanLoads) -> TissueEffects:
        """Compute LO.4 at each load by differences over one standard deviation to either side.

        Raises
        ------
        InputError
            No tumour of the population fits the tissue at both ends.
        Refusal
            The evaluator cannot model a tissue or a load on it.
        """
        count = len(loads.nodes)
        names = [name for name in population.tissue_parameters if not population.ranges[name].is_single]
        if not names:
            return cls({}, CommonErrors((), np.zeros(0), *np.zeros((2, 0, count, 2))))
        deviations = np.array([population.ranges[name].deviation for name in names])
        pairs = [
            [_shift(population, name, sign * sd) for sign in (-1, 1)] for name, sd in zip(names, deviations.tolist(), strict=True)
        ]
        bodies = _draw_bodies(population, [scene for pair in pairs for scene in pair])
        if not len(bodies):
            allowed = "ranges of the tissue within which tumours fit at both ends"
            raise InputError("population", Words("no tumour fits all tissues"), allowed)
        constant, scale, remainder = np.zeros((len(names), count, 2)), np.zeros((len(names), count, 2)), np.zeros((count, 2))
        for index, node in enumerate(loads.nodes):
            predict = partial(_predict_readings, node, bodies, population.poisson_ratio)
            middle = predict(population.middle)[1]
            size = (middle**2).sum(axis=0)
            for number, pair in enumerate(pairs):
                (low_blank, low), (high_blank, high) = map(predict, pair)
                constant[number, index], change = (high_blank - low_blank) / 2, (high - low) / 2
                scale[number, index] = (change * middle).sum(axis=0) / size
                remainder[index] += ((change - scale[number, index] * middle) ** 2).sum(axis=0) / size
        numbers = CommonErrors(tuple(names), deviations, constant, scale)
        errors = numbers.join(CommonErrors.from_channels("tissue_signal", 0 * remainder, np.sqrt(remainder)))
        return cls({name: population.ranges[name].middle for name in names}, errors)


def _shift(population: ScenePopulation, name: str, change: float) -> Scene:
    """Return the tissue with the logarithm of one number off the middle."""
    numbers = {key: population.ranges[key].middle for key in population.tissue_parameters}
    return population.build_tissue_scene(numbers | {name: numbers[name] * float(np.exp(change))})


def _draw_bodies(population: ScenePopulation, scenes: list[Scene]) -> Floats:
    """Return tumours that fit all tissues, columns as in ``TUMOUR_PARAMETERS``, shape (n, 5)."""
    fractions = np.random.default_rng(SEED).random((len(TUMOUR_PARAMETERS), 8 * SAMPLES))
    columns = [population.ranges[key].compute_quantiles(row) for key, row in zip(TUMOUR_PARAMETERS, fractions, strict=True)]
    bodies = np.stack(columns, axis=1)
    misfits = [reason for scene in scenes for reason in population.find_misfits(scene, bodies).values()]
    return np.asarray(bodies[~np.any(misfits, axis=0)][:SAMPLES])


def _predict_readings(node: TumourFree, bodies: Floats, poisson_ratio: float, tissue: Scene) -> tuple[Floats, Floats]:
    """Return ln ratio and ln stiffness without tumours, (2,), and what tumours change at several distances, (n, 2).

    They are those of another ``tissue`` under the load of ``node``.
    """
    sampler = (LinearEffects if node.is_linear else LoadedEffects)(tissue.model_copy(update={"load": node.scene.load}))
    totals = np.abs(stack_totals(sampler.scene, sampler.films))
    offsets = np.array(OFFSETS_OUTER_RADII) * sampler.scene.probe.tube_radius
    depth, diameter, modulus = bodies[:, :3].T
    columns = np.broadcast_arrays(offsets, 0.0, depth[:, None], diameter[:, None], modulus[:, None], poisson_ratio)
    effects = sampler.compute_effects(Tumours(*(np.ravel(column) for column in columns)), reflect=False)
    signals = np.stack([np.log1p(effects[:, 0]) - np.log1p(effects[:, 1]), np.log1p(effects[:, 2])], axis=-1)
    return np.log([totals[-2] / totals[-1], totals[:2].sum()]), signals
