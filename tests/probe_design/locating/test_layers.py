"""Populations whose tumours lie in two layers of a tissue: fat over gland."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.common.arrays import Floats
from probe_design.estimation.measurements import Reading
from probe_design.locating.prior import TumourPrior
from probe_design.locating.run import run_locate
from probe_design.populations.design_file import design_from_dict
from probe_design.populations.population import ScenePopulation
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.reading_tables.tumour_ranges import TumourRanges, build_cubes
from tests.probe_design.locating.test_inference import PLACES
from tests.solver.reading_tables.test_reading_table import IN_FAT, compute_truth

POPULATION = {
    "depth": [6e-3, 20e-3],
    "diameter": [5e-3, 9e-3],
    "object": [16e3, 32e3],
    "x": [-16e-3, 16e-3],
    "least_cover": 2e-3,
    "tumours": 1,
}
DESIGN = design_from_dict({"scene": IN_FAT, "population": POPULATION, "noise": {"white": 0.001, "charge": 0.0}})
PRIOR = TumourPrior.from_design(DESIGN, PLACES[1:])
IN_LAYERS = np.array([[2e-3, -3e-3, 7e-3, 8e-3, 26e3], [-3e-3, 4e-3, 18e-3, 8.8e-3, 30e3]])  # in the fat, in the gland


def test_the_prior_is_that_of_a_design_and_of_the_tables() -> None:
    """Tumours that an interface crosses are left out by all of them."""
    tumours = PRIOR.transform(PRIOR.draw(2048, 1, 0))
    allowed, (x, y, depth, diameter, modulus) = PRIOR.find_allowed(tumours), tumours[:, 0].T
    population = ScenePopulation.from_scene(IN_FAT, DESIGN.population)
    misfits = population.find_misfits(IN_FAT, np.stack([depth, diameter, modulus, x, y], axis=-1))
    assert 0.2 < allowed.mean() < 0.8
    np.testing.assert_array_equal(allowed, ~np.any(list(misfits.values()), axis=0))
    ranges = TumourRanges((6e-3, 20e-3), (5e-3, 9e-3), (16e3, 32e3), PRIOR.poisson_ratio, PRIOR.least_cover)
    covered = [
        (depth >= cube.compute_shallowest(diameter) - 1e-9) & (depth <= cube.compute_deepest(diameter) + 1e-9)
        for cube in build_cubes(ranges, IN_FAT.tissue)
    ]
    np.testing.assert_array_equal(allowed, np.any(covered, axis=0))


def test_the_contrast_is_to_the_layer_that_holds_the_tumour() -> None:
    assert PRIOR.compute_contrast(IN_LAYERS) == pytest.approx(np.log([26 / 3, 30 / 6]))


@pytest.mark.slow
@pytest.mark.parametrize("tumour", IN_LAYERS, ids=["fat", "gland"])
def test_a_tumour_of_either_layer_is_located_in_it(tumour: Floats) -> None:
    """Readings of ``equivalent-inclusion`` with all reflections, with noise of 0.1 % and a gain of 3 %."""
    rng, films = np.random.default_rng(4), EquivalentInclusion().prepare(IN_FAT, 0.003).films
    probe = IN_FAT.probe
    blank = films.totals[0] / films.totals[1] * probe.outer_area / probe.inner_area
    signals = np.concatenate([[0.0], compute_truth(tumour[None], PLACES[1:], IN_FAT)[:, 0]])
    ratios = blank * np.exp(signals + 0.03 + 0.001 * rng.standard_normal(len(PLACES)))
    readings = [
        Reading(x, y, ratio, 0.001, blank=row == 0) for row, ((x, y), ratio) in enumerate(zip(PLACES, ratios, strict=True))
    ]
    result = run_locate(DESIGN, tuple(readings), 0.0, 0, advise=False)
    assert result.explained
    assert result.probability[0] < 1e-3
    (located,) = result.tumours
    names = ("x", "y", "depth", "diameter", "youngs_modulus", "ln_contrast")
    for name, truth in zip(names, (*tumour, PRIOR.compute_contrast(tumour)), strict=True):
        low, high = located.quantities[name].interval_90
        assert low <= truth <= high, name
    assert np.mean((result.best.sets[:, 0, 2] < 12e-3) == (tumour[2] < 12e-3)) > 0.9
    assert any("of 100 tumours of the population are left out" in line for line in result.warnings)
