"""Charge amplifier and measurement against a simulated circuit, Monte Carlo and PHYSICS section 6."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from hw.common.samples import Gap, Samples
from hw.signal.amplifier import ChargeAmplifier, TooSlow
from hw.signal.covariance import propagate_complex_covariance, propagate_covariance, split_parts
from hw.signal.measurement import Measurement, check_measurement
from hw.signal.reading_fit import Losses
from hw.signal.waveform import Flawed
from tests.support.hw.fits import measure_samples

AMPLIFIER = ChargeAmplifier()
CHARGES = np.array([1.0e-12 * np.exp(0.02j), 2.0e-12])


def record(seed: int, frequency: float = 5.0, noise: float = 1e-5, rows: int = 4000, force: bool = False) -> Samples:
    random = np.random.default_rng(seed)
    t = (np.arange(rows) - (rows - 1) / 2) / 500.0
    volts = (CHARGES * AMPLIFIER.response(frequency) * np.exp(2j * np.pi * frequency * t)[:, None]).real
    if force:
        volts = np.column_stack([volts, 0.02 * np.cos(2 * np.pi * frequency * t + 1)])
    volts = volts + noise * random.standard_normal(volts.shape)
    names = ("inner", "outer", "force")[: volts.shape[1]]
    return Samples(
        500.0, names, index=np.arange(rows), volts=volts, saturated=np.zeros(volts.shape, bool), gaps=(), overruns=0, source={}
    )


def test_half_a_hertz_reads_4_7_percent_low() -> None:
    assert AMPLIFIER.corner == pytest.approx(0.159, abs=0.001)
    assert abs(AMPLIFIER.response(0.5)) * AMPLIFIER.capacitance == pytest.approx(1 - 0.047, abs=5e-4)


def test_response_is_that_of_the_simulated_circuit() -> None:
    """Rf and Cf in the feedback: dV/dt = -(dQ/dt) / Cf - V / (Rf Cf), stepped exactly in time for a slow sine."""
    rate, frequency = 20_000.0, 0.4
    t = np.arange(int(20 * rate)) / rate
    charge = 1e-12 * np.sin(2 * np.pi * frequency * t)
    decay = np.exp(-1 / (rate * AMPLIFIER.time_constant))
    volts = lfilter([np.sqrt(decay)], [1, -decay], -np.diff(charge, prepend=0.0) / AMPLIFIER.capacitance)
    late = t >= 10.0  # ten time constants: the start has died away; 4 whole periods
    wave = np.exp(-2j * np.pi * frequency * t[late])
    seen = (volts[late] * wave).mean() / (charge[late] * wave).mean()
    assert seen == pytest.approx(AMPLIFIER.response(frequency), rel=2e-4)


def test_amplifier_is_divided_out() -> None:
    for frequency in (0.5, 5.0):
        measurement = measure_samples(record(1, frequency, rows=20_000), frequency)
        error = np.abs(measurement.charges - CHARGES)
        assert np.all(error < 4 * np.sqrt(np.diag(measurement.covariance))[::2])


def test_tolerance_of_the_parts_is_the_scatter_of_amplifiers() -> None:
    random = np.random.default_rng(2)
    parts = 1 + np.array([0.05, 0.02]) * random.standard_normal((4000, 2))
    for frequency in (None, 5.0):
        built = [replace(AMPLIFIER, resistance=1e9 * r, capacitance=1e-9 * c) for r, c in parts]
        logs = np.array([np.log(amplifier.response(0.5) / AMPLIFIER.response(0.5)) for amplifier in built])
        if frequency is not None:
            logs -= np.array([np.log(amplifier.response(frequency) / AMPLIFIER.response(frequency)) for amplifier in built])
        scatter = np.cov(np.stack([logs.real, logs.imag]))
        deviation = AMPLIFIER.compute_tolerance(0.5, frequency)
        assert np.diag(deviation) == pytest.approx(np.diag(scatter), rel=0.15)


def test_slow_loads_are_refused() -> None:
    with pytest.raises(TooSlow, match="corner"):
        AMPLIFIER.response(0.05)


@pytest.mark.slow
def test_ratio_and_its_covariance_against_monte_carlo() -> None:
    measurements = [measure_samples(record(seed), 5.0) for seed in range(150)]
    ratios = np.array([measurement.charges[0] / measurement.charges[1] for measurement in measurements])
    stated = np.mean(
        [
            propagate_complex_covariance(lambda q: split_parts(q[:1] / q[1:]), measurement.charges, measurement.covariance)
            for measurement in measurements
        ],
        axis=0,
    )
    scatter = np.cov(np.stack([ratios.real, ratios.imag]))
    assert np.diag(stated) == pytest.approx(np.diag(scatter), rel=3 * np.sqrt(2 / 150))
    truth = CHARGES[0] / CHARGES[1]
    assert abs(ratios.mean() - truth) < 4 * np.sqrt(np.trace(scatter) / 150)
    lag, spread = measurements[0].lag
    assert lag == pytest.approx(0.02, abs=4 * spread)


def test_delta_method_of_a_known_function() -> None:
    """x / y: the relative variances add."""
    spread = propagate_covariance(lambda x: x[:1] / x[1:], np.array([3.0, 2.0]), np.diag([0.09, 0.01]))
    assert spread[0, 0] == pytest.approx(1.5**2 * (0.09 / 9 + 0.01 / 4), rel=1e-6)


def test_in_phase_parts_add_up_to_the_sum() -> None:
    measurement = measure_samples(record(3), 5.0)
    assert measurement.in_phase.sum() == pytest.approx(abs(measurement.charges.sum()), rel=1e-12)
    assert np.all(np.diag(measurement.in_phase_covariance) > 0)


def test_force_channel_is_optional() -> None:
    assert measure_samples(record(4, force=True), 5.0).force is None
    measurement = measure_samples(record(4, force=True), 5.0, sensitivity=0.1)
    assert measurement.force == pytest.approx(0.2, abs=4 * (measurement.force_sd or 0.0))
    assert measure_samples(record(4), 5.0, sensitivity=0.1).force is None


def clean() -> Measurement:
    return measure_samples(record(5), 5.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [({"gaps": 2}, "2 gaps"), ({"overruns": 1}, "overrun"), ({"saturated": 7}, "saturated"), ({}, "cycles")],
)
def test_flaws_are_refused(change: dict[str, int], words: str) -> None:
    check_measurement(clean(), 20)
    with pytest.raises(Flawed, match=words):
        check_measurement(replace(clean(), losses=Losses(**change)), 20 if change else 200)


def test_a_load_that_is_off_is_refused() -> None:
    for seed in range(30):
        silent = replace(record(6), volts=1e-5 * np.random.default_rng(seed).standard_normal((4000, 2)))
        with pytest.raises(Flawed, match="is it on"):
            measure_samples(silent, 5.0)
    weak = measure_samples(record(6, noise=6e-3), 5.0)
    with pytest.raises(Flawed, match="standard deviation"):
        check_measurement(weak, 20)


def test_what_is_lost_is_counted() -> None:
    whole = record(7)
    saturated = whole.saturated.copy()
    saturated[10:15, 0] = True
    measurement = measure_samples(replace(whole, saturated=saturated, gaps=(Gap(5, 2, "lost"),), overruns=3), 5.0)
    assert measurement.losses == Losses(saturated=5, gaps=1, overruns=3)


def test_both_films_are_needed() -> None:
    with pytest.raises(Flawed, match="outer"):
        measure_samples(replace(record(8), channels=("inner", "other")), 5.0)
