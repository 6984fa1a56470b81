"""Control variates: the mean stays right, the stated error is that of repeated samples, and what the evaluator bounds do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import norm

from geometry.common.arrays import Floats
from probe_design.populations.detection import Detector, compute_log_likelihood_ratio, whiten
from probe_design.populations.objective import Objective
from probe_design.populations.performance import ControlSample, estimate_statistic
from probe_design.populations.population import ScenePopulation
from tests.support.designs import SUPERFICIAL, example_design

VERIFIED, MANY, REPEATS = 40, 512, 2000
TRUE = 0.6  # of the deflections' sensitivity, by the verifying evaluator; that of the closed form differs


def probabilities(sizes: Floats, derivative: float, rng: np.random.Generator, scans: int) -> Floats:
    """Shares of scans in which tumours of some sizes are detected: P = Phi(slope size - 1), drawn."""
    return np.asarray(rng.binomial(scans, ndtr(derivative * sizes - 1)) / scans)


def repeated(derivative: float) -> tuple[Floats, Floats, Floats]:
    """Means, their stated errors, and plain means of repeated samples, the sizes normal."""
    rng, estimates = np.random.default_rng(0), []
    for _ in range(REPEATS):
        sizes, controls = rng.standard_normal(VERIFIED), rng.standard_normal(MANY)
        seed = rng.integers(2**31)
        verified, predicted = (
            probabilities(sizes, chosen_slope, np.random.default_rng(seed), 256) for chosen_slope in (TRUE, derivative)
        )
        control = ControlSample(predicted, probabilities(controls, derivative, rng, 64), np.zeros(MANY, dtype=int))
        estimates.append((*estimate_statistic(verified, np.zeros(VERIFIED, dtype=int), Objective(), control), verified.mean()))
    mean, error, plain = np.array(estimates).T
    return mean, error, plain


@pytest.mark.parametrize("derivative", [TRUE, 0.66, 0.5])
def test_intervals_of_controlled_means_cover_the_truth_though_the_formulas_are_wrong(derivative: float) -> None:
    mean, error, plain = repeated(derivative)
    truth = ndtr(-1 / np.hypot(1, TRUE))  # of Phi(slope x - 1) over normal x, in closed form
    covered = np.mean(np.abs(mean - truth) < norm.ppf(0.975) * error)
    assert 0.93 < covered < 0.97
    assert abs(mean.mean() - truth) < 4 * plain.std() / np.sqrt(REPEATS)
    assert mean.std() < 0.45 * plain.std()
    assert error.mean() == pytest.approx(mean.std(), rel=0.1)


def test_formulas_that_know_nothing_do_not_count() -> None:
    rng = np.random.default_rng(1)
    values, group = rng.uniform(size=VERIFIED), np.zeros(VERIFIED, dtype=int)
    control = ControlSample(rng.uniform(size=VERIFIED), rng.uniform(size=MANY), np.zeros(MANY, dtype=int))
    mean, error = estimate_statistic(values, group, Objective(), control)
    alone = estimate_statistic(values, group, Objective(), None)
    assert mean == alone[0]
    assert alone[1] <= error < 1.2 * alone[1]
    quantile = Objective(statistic=0.2)
    assert estimate_statistic(values, group, quantile, control) == (
        quantile.compute_statistic(values),
        quantile.compute_error(values, group),
    )


def test_few_tumours_that_are_all_detected_do_not_make_the_sampling_error_vanish() -> None:
    """Two tumours, both detected, gave 100 of 100 with an error of 0, where the formulas detect 7 of 10 others."""
    rng, group = np.random.default_rng(2), np.zeros(2, dtype=int)
    control = ControlSample(np.array([0.97, 1.0]), rng.uniform(0.4, 1.0, MANY), np.zeros(MANY, dtype=int))
    mean, error = estimate_statistic(np.ones(2), group, Objective(), control)
    assert abs(mean - 0.7) < 0.05
    assert error > 0.01


def test_slopes_of_the_detector_are_those_of_its_statistic() -> None:
    rng = np.random.default_rng(2)
    A = rng.standard_normal((5, 5))
    detector = Detector.train(rng.standard_normal((7, 5)), A @ A.T + np.eye(5), 0.05, blanks=256)
    signals, step = rng.standard_normal((3, 5)), 1e-6
    derivatives = detector.compute_derivatives(signals)
    for j in range(5):
        sides = [
            compute_log_likelihood_ratio(detector.templates, whiten(detector.factor, signals + shift * np.eye(5)[j]))
            for shift in (step, -step)
        ]
        assert (sides[0] - sides[1]) / (2 * step) == pytest.approx(derivatives[:, j], rel=1e-5, abs=1e-7)


def test_no_errors_within_their_bounds_lose_more_than_those_that_bound_the_level() -> None:
    rng = np.random.default_rng(3)
    detector = Detector.train(0.7 * rng.standard_normal((64, 6)), np.eye(6) + 1, 0.05)
    signals, bound = 0.7 * rng.standard_normal((200, 6)), 0.15 * rng.uniform(size=(200, 6))
    error = bound * np.sign(detector.compute_derivatives(signals))
    low, mean, high = (float(detector.compute_probabilities(signals + shift).mean()) for shift in (-error, 0.0, error))
    assert low < mean - 0.01
    for _ in range(8):
        random_error = bound * rng.choice([-1.0, 1.0], size=bound.shape)
        assert low < detector.compute_probabilities(signals + random_error).mean() < high


def test_more_tissues_may_be_drawn_than_a_verification_has_time_for() -> None:
    design = example_design(population={**SUPERFICIAL, "tissue": ["4 kPa", "9 kPa"]})
    population = ScenePopulation.from_scene(design.scene, design.population)
    few_tissues, many_tissues = population.draw_tumours(64), population.draw_tumours(64, tissues=32)
    assert (len(few_tissues.tissues), len(many_tissues.tissues)) == (4, 32)
    assert len({tissue.tissue.youngs_modulus for tissue in many_tissues.tissues}) == 32
