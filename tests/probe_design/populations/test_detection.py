"""The detector against simulated scans: another path to the noise, and the likelihood written out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

from geometry.common.arrays import Floats
from probe_design.populations.design_file import Design
from probe_design.populations.detection import (
    Detector,
    compute_known_probabilities,
    compute_log_likelihood_ratio,
)
from probe_design.populations.noise import build_difference_noise
from probe_design.populations.population import ScenePopulation
from probe_design.populations.scan_readings import ScanReadings, compute_closed_form_readings
from probe_design.populations.tables import NoiseModel, Protocol
from tests.support.designs import SUPERFICIAL, THREE, example_design

ALARMS = 0.05


def simulated(noise: NoiseModel, protocol: Protocol, scans: int, seed: int) -> Floats:
    """Errors of readings as they come about: each by itself, gains of a scan, and a blank that is taken from all; (scans, m)."""
    rng, p = np.random.default_rng(seed), len(protocol.positions)
    columns = []
    for white, gain in ((noise.white, np.sqrt(2) * noise.gain), (noise.stiffness_white, noise.stiffness_gain)):
        errors = gain * rng.standard_normal((scans, 1)) + white * rng.standard_normal((scans, p + 1))
        columns.append(errors[:, :p] - errors[:, p:] * protocol.blank)
    return np.concatenate(columns[: protocol.channels], axis=1)


def readings_of(design: Design, samples: int) -> ScanReadings:
    population = ScenePopulation.from_scene(design.scene, design.population)
    return compute_closed_form_readings(population.draw_tumours(samples), design.protocol)


def probability_by_simulation(noise: NoiseModel, protocol: Protocol, known: Floats, tumours: Floats, scans: int) -> Floats:
    """P of each tumour, with the densities of scipy and the covariance of the simulated errors' own model, written out."""
    p = len(protocol.positions)
    blocks = []
    for white, gain in ((noise.white, np.sqrt(2) * noise.gain), (noise.stiffness_white, noise.stiffness_gain)):
        mixing = np.hstack(
            [np.eye(p) * white, np.full((p, 1), -white * protocol.blank), np.full((p, 1), gain * (not protocol.blank))]
        )
        blocks.append(mixing @ mixing.T)
    C = np.zeros((p * protocol.channels,) * 2)
    for k, block in enumerate(blocks[: protocol.channels]):
        C[k * p : (k + 1) * p, k * p : (k + 1) * p] = block

    def statistic(y: Floats) -> Floats:
        log_density = np.array([multivariate_normal.logpdf(y, mean, C) for mean in known])
        return np.asarray(
            logsumexp(log_density, axis=0) - np.log(len(known)) - multivariate_normal.logpdf(y, np.zeros(len(C)), C)
        )

    threshold = np.quantile(statistic(simulated(noise, protocol, 4 * scans, 11)), 1 - ALARMS)
    return np.array(
        [(statistic(signal + simulated(noise, protocol, scans, 12 + k)) > threshold).mean() for k, signal in enumerate(tumours)]
    )


@pytest.mark.parametrize("blank", [True, False])
def test_probabilities_are_those_of_simulated_scans(blank: bool) -> None:
    compare(blank, tumours=6, known=12, scans=1000, tolerance=0.04)


@pytest.mark.slow
@pytest.mark.parametrize("blank", [True, False])
def test_probabilities_are_those_of_ten_thousand_simulated_scans(blank: bool) -> None:
    compare(blank, tumours=8, known=48, scans=10_000, tolerance=0.02)


def compare(blank: bool, *, tumours: int, known: int, scans: int, tolerance: float) -> None:
    design = example_design(
        population=SUPERFICIAL,
        protocol={**THREE, "blank": blank},
        noise={"charge": "0 pC", "white": 0.03, "stiffness_white": 0.02},
    )
    signals = readings_of(design, known + tumours)
    signals_known, tried = signals.signal[:known], signals.signal[known:]
    C = build_difference_noise(design.noise, design.protocol, design.scene, signals.blank[0]).covariance
    detector = Detector.train(signals_known, C, ALARMS)
    probabilities = detector.compute_probabilities(tried, scans=4 * scans)
    expected = probability_by_simulation(design.noise, design.protocol, signals_known, tried, scans)
    assert 0.1 < expected.mean() < 0.95
    assert np.abs(probabilities - expected).max() < 1.5 * tolerance
    assert abs(probabilities.mean() - expected.mean()) < tolerance


def test_one_tumour_is_found_as_the_deflection_says() -> None:
    rng = np.random.default_rng(0)
    mixing = rng.standard_normal((6, 6))
    C, signal = mixing @ mixing.T, rng.standard_normal((1, 6))
    d = np.sqrt(signal[0] @ np.linalg.inv(C) @ signal[0])
    exact = norm.cdf(d - norm.ppf(1 - ALARMS))
    assert Detector.train(signal, C, ALARMS).compute_probabilities(signal)[0] == pytest.approx(exact, rel=1e-12)
    assert compute_known_probabilities(np.array([d]), ALARMS)[0] == pytest.approx(exact, rel=1e-12)


def test_no_detector_finds_more_than_that_of_the_known_tumour() -> None:
    signals, C = np.random.default_rng(1).standard_normal((20, 4)) * 1.5, np.eye(4)
    known = compute_known_probabilities(np.linalg.norm(signals, axis=1), ALARMS)
    assert np.all(
        Detector.train(signals, C, ALARMS).compute_probabilities(signals, scans=4000) < known + 4 * np.sqrt(0.25 / 4000)
    )


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-17, 1e-9, 1e-3])
def test_tumours_without_effect_are_found_as_often_as_none(size: float) -> None:
    signals = size * np.random.default_rng(2).standard_normal((40, 4))
    probabilities = Detector.train(signals, np.eye(4), ALARMS).compute_probabilities(signals, scans=4096)
    assert probabilities.mean() == pytest.approx(ALARMS, abs=0.004)


@pytest.mark.parametrize("noise", [1e-6, 1e-12])
def test_hardly_any_noise_hides_no_tumour(noise: float) -> None:
    signals = np.abs(np.random.default_rng(3).standard_normal((40, 4))) * 0.01
    with np.errstate(all="raise", under="ignore"):
        probabilities = Detector.train(signals[:20], noise**2 * np.eye(4), ALARMS).compute_probabilities(signals[20:])
    assert np.all(probabilities == 1.0)


def test_likelihood_ratios_are_what_they_say() -> None:
    templates, z = np.random.default_rng(4).standard_normal((7, 3)), np.random.default_rng(5).standard_normal((11, 3))
    for scale in (1e-8, 1e-3, 1.0, 20.0):
        u = scale * templates
        exact = logsumexp([norm.logpdf(z, shift).sum(axis=1) - norm.logpdf(z).sum(axis=1) for shift in u], axis=0) - np.log(7)
        assert compute_log_likelihood_ratio(u, z) == pytest.approx(exact, rel=1e-12, abs=1e-14)


def test_the_same_draws_serve_two_designs() -> None:
    """So that their difference is that of the designs, far below what either one's draws scatter."""
    signals, C = np.random.default_rng(6).standard_normal((30, 4)), np.eye(4)
    first, second = (
        Detector.train(scale * signals, C, ALARMS).compute_probabilities(scale * signals).mean() for scale in (1.0, 1.001)
    )
    assert abs(second - first) < 0.002
