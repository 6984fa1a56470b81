"""The force channel's phase: against closed forms of filter and play, and what calibrations and readings make of it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import freqz, lfilter

from geometry.common.arrays import Floats
from hw.common.samples import Samples
from hw.signal.measurement import Measurement
from hw.signal.waveform import Flawed
from probe_design.built_probe.film_forces import build_observation, measure_samples
from probe_design.built_probe.gain_fit import estimate_gains
from probe_design.built_probe.timing_errors import compute_force_lag, estimate_amplitude_loss
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals
from tests.support.hw.benches import BENCH, films, sampled, scene, shares

BUILT = BuiltProperties(noise=2e-6, frequency=1.0)
RATE = 2000.0


def pressed(reference_index: int = 4) -> Samples:
    """A reading on a reference whose force channel shows the load alone, as it is."""
    forces = films(shares().log_ratios)[reference_index]
    return sampled(build_signals(BUILT, BENCH, scene(), forces, [8, reference_index]), rows=10_000, rate=RATE)


def with_force(samples: Samples, force: Floats) -> Measurement:
    volts = samples.volts.copy()
    volts[:, 2] = force
    return measure_samples(replace(samples, volts=volts), BENCH)


def filtered(volts: Floats, seconds: float) -> Floats:
    keep = math.exp(-1 / (RATE * seconds))
    return np.asarray(lfilter([1 - keep], [1, -keep], volts, zi=[keep * volts[0]])[0])


def response(seconds: float) -> complex:
    """Of that filter at the load's frequency."""
    keep = math.exp(-1 / (RATE * seconds))
    return complex(freqz([1 - keep], [1, -keep], [BENCH.load.frequency], fs=RATE)[1][0])


def played(volts: Floats, width: float) -> Floats:
    position, output = float(volts[0]), []
    for volt in volts.tolist():
        position = min(max(position, volt - width), volt + width)
        output.append(position)
    return np.array(output)


def describing(half_width: float) -> complex:
    """Play's output over its input, first harmonic: the textbook's closed form."""
    turn = math.acos(1 - 2 * half_width)
    real = 1 - (turn - math.sin(turn) * math.cos(turn)) / math.pi
    return complex(real, -4 * half_width * (1 - half_width) / math.pi)


def test_loss_bounds_play_and_filters() -> None:
    for half_width in (0.001, 0.01, 0.02, 0.05, 0.1):
        factor = describing(half_width)
        bound = estimate_amplitude_loss(np.angle(factor))
        assert 1 - abs(factor) < bound < 1.5 * (1 - abs(factor))
    lags = np.linspace(0.001, 1.0, 50)
    assert all(1 - math.cos(lag) < estimate_amplitude_loss(lag) for lag in lags)


def test_a_good_force_channel_does_not_lag() -> None:
    measurement = with_force(pressed(), pressed().volts[:, 2])
    lag, spread = compute_force_lag(measurement, BENCH)
    assert abs(lag) < 3 * spread
    assert (measurement.force_loss, measurement.warnings) == (0.0, ())
    turned = with_force(pressed(), -pressed().volts[:, 2])  # a sensor the other way round
    assert compute_force_lag(turned, BENCH)[0] == pytest.approx(lag, abs=1e-3)


@pytest.mark.parametrize("seconds", [0.001, 0.004])
def test_a_filter_s_lag_and_loss(seconds: float) -> None:
    samples = pressed()
    measurement, good = with_force(samples, filtered(samples.volts[:, 2], seconds)), measure_samples(samples, BENCH)
    lag, spread = compute_force_lag(measurement, BENCH)
    assert lag == pytest.approx(-np.angle(response(seconds)), abs=4 * spread)
    assert good.force
    assert measurement.force
    lost = 1 - measurement.force / good.force
    assert lost == pytest.approx(1 - abs(response(seconds)), abs=2e-4)
    assert lost < measurement.force_loss
    assert "the force channel lags" in measurement.warnings[-1]


def test_play_is_seen_by_its_lag_and_its_loss_is_counted() -> None:
    """Of 2 % of the amplitude: before, there was no warning, and half of what the sensor's tolerance allows was lost."""
    samples = pressed()
    force = samples.volts[:, 2]
    measurement, good = with_force(samples, played(force, 0.02 * np.ptp(force) / 2)), measure_samples(samples, BENCH)
    lag, spread = compute_force_lag(measurement, BENCH)
    assert lag == pytest.approx(-np.angle(describing(0.02)), abs=4 * spread + 1e-3)
    assert good.force
    assert measurement.force
    assert measurement.force_sd
    stated = math.hypot(measurement.force_loss, measurement.force_sd / measurement.force)  # by its lag, or its harmonics
    assert 0.003 < 1 - measurement.force / good.force < stated < 0.02


def test_a_filter_of_10_ms_is_refused_and_a_known_delay_corrected() -> None:
    """Gains came out 8 standard deviations too large."""
    samples = pressed()
    with pytest.raises(Flawed, match="lags the films by 0\\.3"):
        with_force(samples, filtered(samples.volts[:, 2], 0.01))
    late = np.roll(samples.volts[:, 2], 40)  # 20 ms
    assert BENCH.force
    slow_bench = BENCH.model_copy(update={"force": BENCH.force.model_copy(update={"delay": 0.02})})
    volts = samples.volts.copy()
    volts[:, 2] = late
    measurement = measure_samples(replace(samples, volts=volts), slow_bench)
    assert measurement.force_loss == 0.0
    with pytest.raises(Flawed, match="lags"):
        measure_samples(replace(samples, volts=volts), BENCH)


def test_doubt_of_all_readings_alike_does_not_average_out() -> None:
    seen = [
        build_observation(measure_samples(pressed(k), BENCH), observed_reading, scene())
        for k, observed_reading in enumerate(BENCH.reference)
    ]
    assert BENCH.force
    bench = BENCH.model_copy(update={"force": BENCH.force.model_copy(update={"verified": True})})
    good = estimate_gains(seen, shares(), bench)
    lagging = estimate_gains([replace(observed_reading, force_loss=0.04) for observed_reading in seen], shares(), bench)
    widened = np.sqrt(np.diag(lagging.covariance)[[0, 3]] - np.diag(good.covariance)[[0, 3]])
    assert widened == pytest.approx(0.04 * np.diag(good.matrix), rel=0.05)
