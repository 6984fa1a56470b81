"""Rounds of importance sampling remember what the last one missed, and converge where posteriors are narrow."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from geometry.common.arrays import Floats
from probe_design.locating.common_errors import CommonErrors
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.mixtures import StudentMixture
from probe_design.locating.prior import TumourPrior
from probe_design.locating.rounds import Rounds, weigh
from probe_design.locating.samples import compute_log_prior
from probe_design.locating.sampling import draw_posterior
from probe_design.locating.scan_data import ScanData
from probe_design.populations.design_file import design_from_dict
from tests.support.paths import ROOT
from tests.support.stand_in_model import StandInModel

SEEDS = (1, 3)  # of scans whose effective samples were 5 and 732 after eight rounds, each fitted to the last one alone


def build_proposal(middle: float, spread: float) -> StudentMixture:
    return StudentMixture(np.ones(1), np.array([[middle]]), np.array([[[spread]]]))


def test_what_a_round_misses_keeps_the_weight_of_the_round_before() -> None:
    """Two modes, a third of the probability in the second, where the last proposal hardly draws."""

    def evaluate(z: Floats) -> Floats:
        density = 2 / 3 * norm.pdf(z[:, 0], -4, 0.3) + 1 / 3 * norm.pdf(z[:, 0], 4, 0.3)
        return np.asarray(np.log(density + 1e-300)) - compute_log_prior(z)

    rng = np.random.default_rng(0)
    wide, narrow = (weigh(evaluate, build_proposal(*part), 8000, rng) for part in ((0.0, 5.0), (-4.0, 0.4)))
    z, log_weights = Rounds((wide, narrow)).join()
    weights = np.exp(log_weights)
    assert weights.mean() == pytest.approx(1, abs=0.03)
    assert weights[z[:, 0] > 0].sum() / weights.sum() == pytest.approx(1 / 3, abs=0.03)


@pytest.mark.slow
def test_many_exact_readings_converge() -> None:
    """400 readings of 0.3 %, which leave a ten-millionth of the population."""
    line, noise = np.linspace(-16e-3, 16e-3, 20), np.array([0.003, 0.03])
    places = np.array([(30e-3, 0.0), *((x, y) for y in line for x in line)])  # the baseline reading first
    ranges = {"depth": [5e-3, 25e-3], "diameter": [4e-3, 16e-3], "object": [8e3, 160e3], "x": [-16e-3, 16e-3], "tumours": 1}
    population = ranges | {"least_cover": 2e-3}
    design = design_from_dict({"scene": str(ROOT / "examples" / "scene.toml"), "population": population})
    prior, n = TumourPrior.from_design(design, places[1:]), len(places)
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        tumours = prior.transform(rng.random((64, 1, 5)))
        tumours = tumours[prior.find_allowed(tumours)][:1]
        values = noise * rng.standard_normal((n, 2))
        values[1:] += StandInModel().predict(tumours, places[1:])[0]
        values[:, 1] = 0.0
        variance = np.tile([noise[0] ** 2, np.inf], (n, 1))
        gains = CommonErrors.from_channels("ln_gain", np.array([0.07, 0.05]))
        data = ScanData(places, values, variance, np.zeros((n, 2)), np.arange(n) == 0, gains)
        sample = draw_posterior(Likelihood(data, (StandInModel(),), prior), 1, 0)
        assert sample.is_converged, seed
