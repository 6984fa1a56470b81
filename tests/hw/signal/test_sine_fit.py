"""Sine fits against known signals, the Cramer-Rao bound and their own covariance."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from hw.common.samples import Gap, Samples
from hw.signal.sine_fit import NoSine, SineFit
from tests.support.hw.fits import fit_sine

RATE, ROWS, FREQUENCY = 500.0, 4000, 5.003
AMPLITUDES = np.array([1.0 * np.exp(0.3j), 0.5 * np.exp(0.28j)])
NOISE = 0.0094  # V: the bound on the first amplitude is then sqrt(2 / ROWS) NOISE = 0.021 %, as in PHYSICS section 6


def record(
    seed: int, rows: int = ROWS, hum: float = 0.5, drift: float = 1.0, walk: float = 0.0, frequency: float = FREQUENCY
) -> Samples:
    """Sine, mains with a third harmonic, drift and noise of two channels; phases count from the middle of the record."""
    random = np.random.default_rng(seed)
    index = np.arange(rows)
    t = (index - (rows - 1) / 2) / RATE
    volts = (AMPLITUDES * np.exp(2j * np.pi * frequency * t)[:, None]).real
    mains = np.cos(2 * np.pi * 50.07 * t + 1) + 0.2 * np.cos(2 * np.pi * 150.21 * t)
    volts = volts + hum * mains[:, None] * [1.0, 0.7]
    volts = volts + drift * ((t / t[-1]) + 0.3 * (t / t[-1]) ** 2)[:, None] * [1.0, 0.5]
    volts = volts + NOISE * random.standard_normal((rows, 2)) + walk * np.cumsum(random.standard_normal((rows, 2)), axis=0)
    return Samples(
        RATE, ("inner", "outer"), index=index, volts=volts, saturated=np.zeros((rows, 2), bool), gaps=(), overruns=0, source={}
    )


@cache
def fits(count: int = 60) -> list[SineFit]:
    return [fit_sine(record(seed), 5.0) for seed in range(count)]


def deviations(fit: SineFit) -> NDArray[np.float64]:
    """Errors of (re, im) of both amplitudes over their standard deviations."""
    errors = fit.amplitudes - AMPLITUDES
    return np.stack([errors.real, errors.imag], axis=1).ravel() / np.sqrt(np.diag(fit.covariance))


def test_bias_and_spread_reach_the_cramer_rao_bound() -> None:
    errors = np.array([abs(fit.amplitudes[0]) - 1 for fit in fits()])
    bound = np.sqrt(2 / ROWS) * NOISE
    assert bound == pytest.approx(2.1e-4, rel=0.01)
    assert abs(errors.mean()) < 3 * bound / np.sqrt(60)
    assert errors.std() == pytest.approx(bound, rel=3 / np.sqrt(2 * 60))
    assert np.ptp(record(0).volts[:, 0]) / 2 > 1.6  # what reading peaks would make of it: +60 % and more


def test_covariance_is_the_scatter() -> None:
    z = np.array([deviations(fit) for fit in fits()])
    assert np.mean(z**2) == pytest.approx(1.0, abs=3 * np.sqrt(2 / z.size))


def test_coloured_noise_is_seen_and_counted() -> None:
    """A random walk has ten times the power of the white noise at the load: without a look at the spectrum z would be 3."""
    walked = [fit_sine(record(seed, walk=2e-3), 5.0) for seed in range(30)]
    z = np.array([deviations(fit) for fit in walked])
    assert np.mean([np.diag(fit.density) / fit.noise**2 for fit in walked]) > 2
    assert 0.5 < np.mean(z**2) < 1.5
    assert np.mean([np.diag(fit.density) / fit.noise**2 for fit in fits()]) < 1.05


def test_frequencies_are_found() -> None:
    fit = fit_sine(record(1), 5.0)
    assert abs(fit.frequency - FREQUENCY) < 4 * fit.frequency_sd < 1e-3
    assert fit.mains == pytest.approx(50.07, abs=1e-3)
    assert fit_sine(record(1), 5.4).frequency == pytest.approx(fit.frequency, abs=1e-6)
    assert fit.cycles == pytest.approx(FREQUENCY * (ROWS - 1) / RATE, rel=1e-4)


def test_no_mains_where_there_are_none() -> None:
    assert fit_sine(record(2, hum=0.0), 5.0).mains is None


def test_drift_and_offset_are_told() -> None:
    """1.0 x + 0.3 x^2 on [-1, 1] goes from -0.7 to 1.3; its mean is 0.1."""
    fit = fit_sine(record(3), 5.0)
    assert fit.drift[0] == pytest.approx(2.0, abs=0.01)
    assert abs(fit.offsets[0] - 0.1) < 4 * fit.offsets_sd[0]


def test_gaps_and_saturation_are_left_out_not_filled() -> None:
    whole = record(4)
    kept = np.r_[0:1500, 2100:ROWS]
    clipped = whole.volts.copy()
    high = clipped[:, 0] > 1.5
    clipped[high, 0] = 1.5
    saturated = np.stack([high, np.zeros(ROWS, bool)], axis=1)
    gap = (Gap(1500, 600, "lost"),)
    cut = replace(whole, index=kept, volts=clipped[kept], saturated=saturated[kept], gaps=gap)
    fit = fit_sine(cut, 5.0)
    assert fit.rows == len(kept) - high[kept].sum() < ROWS - 600
    assert np.abs(deviations(fit)).max() < 4
    ignored = fit_sine(replace(cut, saturated=np.zeros_like(cut.saturated)), 5.0)
    assert np.abs(deviations(ignored)).max() > 6  # clipping matters, so that leaving it out does


def test_slices_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = fit_sine(record(5), 5.0)
    monkeypatch.setattr("hw.signal.sine_model.SLICE_ROWS", 777)
    assert fit_sine(record(5), 5.0).amplitudes == pytest.approx(whole.amplitudes, abs=1e-10)


@pytest.mark.parametrize(
    ("frequency", "rows", "words"),
    [
        (0.2, ROWS, "at least 3 are needed"),
        (225.0, ROWS, "2.5 a period"),
        (5.0, 20, "are needed"),
        (50.3, ROWS, "mains at 50"),
        (99.5, ROWS, "mains at 100"),
    ],
)
def test_refusals_are_one_line(frequency: float, rows: int, words: str) -> None:
    with pytest.raises(NoSine, match=words) as refused:
        fit_sine(record(6, rows=rows), frequency)
    assert "\n" not in str(refused.value)


def test_harmonic_beside_the_mains_is_refused() -> None:
    """10.02 Hz five times over is no harmonic that is fitted; 16.7 Hz three times over lies 0.03 Hz from 50.07 Hz."""
    assert abs(fit_sine(record(7, frequency=10.02), 10.02).amplitudes[0]) == pytest.approx(1.0, abs=1e-3)
    with pytest.raises(NoSine, match="mains"):
        fit_sine(record(7, frequency=16.7), 16.7)


def test_a_frequency_without_load_is_left_or_shows_noise_only() -> None:
    fit = fit_sine(record(8, hum=0.0), 40.0)
    assert abs(fit.amplitudes[0]) < 5 * np.sqrt(fit.covariance[0, 0])


def test_records_that_hold_nothing_are_refused() -> None:
    whole = record(9)
    far = replace(whole, index=np.r_[whole.index[:2000], whole.index[2000:] + 10**9])
    still = replace(whole, volts=whole.volts * [1.0, 0.0])
    blank = replace(whole, volts=whole.volts * np.nan)
    for samples, words in ((far, "arrived"), (still, "outer shows no change"), (blank, "inner shows no change, or no numbers")):
        with pytest.raises(NoSine, match=words):
            fit_sine(samples, 5.0)


@pytest.mark.parametrize("scale", [1e-160, 1e-305])
def test_channels_that_hardly_change_are_refused_in_words(scale: float) -> None:
    whole = record(1)
    with pytest.raises(NoSine, match="inner shows no change"):
        fit_sine(replace(whole, volts=scale * whole.volts), 5.0)


def test_indices_however_large_give_the_same_fit() -> None:
    whole = record(1)
    late = fit_sine(replace(whole, index=whole.index + 2**62), 5.0)
    assert late.amplitudes == pytest.approx(fit_sine(whole, 5.0).amplitudes, rel=1e-12)


@pytest.mark.parametrize(("period", "left"), [(40, 4), (100, 12)])
def test_a_record_of_which_most_of_each_cycle_is_cut_off_is_refused(period: int, left: int) -> None:
    """Amplitudes 100 to 1000 times too large came of it, with as large a standard deviation, and a warning of numpy."""
    whole = record(1, hum=0.0, frequency=RATE / period)
    cut = np.repeat(whole.index[:, None] % period >= left, 2, axis=1)
    with pytest.raises(NoSine, match="do not determine a sinusoid"):
        fit_sine(replace(whole, saturated=cut), RATE / period)
