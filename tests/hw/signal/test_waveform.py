"""Waves that are not what a fit takes them for: refused, or an error stated that is not below the true one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from hw.common.errors import HardwareError
from hw.common.samples import Gap, Samples
from hw.signal.covariance import propagate_covariance
from hw.signal.measurement import Measurement
from hw.signal.sine_fit import NoSine
from hw.signal.waveform import Flawed
from tests.support.hw.fits import fit_sine, measure_samples

Floats = NDArray[np.float64]
RATE, LOAD = 500.0, 5.003
TRUE = np.array([0.9e-3, -1.6e-3, 1e-2])  # V: inner, outer, force, which is of the other sign
T = np.arange(5000) / RATE


def samples(volts: Floats, index: NDArray[np.int64] | None = None, gaps: tuple[Gap, ...] = (), rate: float = RATE) -> Samples:
    rows = np.arange(len(volts)) if index is None else index
    unsaturated = np.zeros(volts.shape, bool)
    return Samples(
        rate, ("inner", "outer", "force"), index=rows, volts=volts, saturated=unsaturated, gaps=gaps, overruns=0, source={}
    )


def volts(seed: int, turns: Floats | None = None, hum: float = 4e-4, noise: float = 1e-5) -> Floats:
    """A load with a second harmonic of 1 % that all channels show alike, mains and noise."""
    random = np.random.default_rng(seed)
    angle = (2 * np.pi * LOAD * T if turns is None else turns) + random.uniform(0, 6)
    load = np.outer(np.cos(angle) + 0.01 * np.cos(2 * angle), TRUE)
    mains = hum * np.cos(2 * np.pi * 50.03 * T + random.uniform(0, 6))
    return np.asarray(load + np.outer(mains, [1, 0.7, 0.1]) + noise * random.standard_normal(load.shape))


def measure_volts(volts: Floats, sensitivity: float | None = 0.1) -> Measurement:
    return measure_samples(samples(volts), 5.0, sensitivity)


def deviation(measurement: Measurement) -> float:
    """Error of the films' ratio over its stated standard deviation; films of unlike sign stay so."""
    spread = propagate_covariance(lambda x: x[:1] / x[1:], measurement.in_phase, measurement.in_phase_covariance)
    return float((measurement.in_phase[0] / measurement.in_phase[1] - TRUE[0] / TRUE[1]) / np.sqrt(spread[0, 0]))


def change_channel(channel: int, change: Callable[[Floats], Floats], seed: int = 1, **options: float) -> Floats:
    whole = volts(seed, **options)
    whole[:, channel] = change(whole[:, channel])
    return whole


def clip(share: float) -> Callable[[Floats], Floats]:
    return lambda v: np.clip(v, -share * np.abs(v).max(), share * np.abs(v).max())


def test_good_readings_are_believed() -> None:
    z = [deviation(measure_volts(volts(seed))) for seed in range(8)]
    assert np.sqrt(np.mean(np.square(z))) < 1.6
    assert all(measure_volts(volts(seed)).warnings == () for seed in range(3))


REFUSED: dict[str, tuple[Callable[[], Floats], str]] = {
    "cut off": (lambda: change_channel(0, clip(0.6)), "inner has harmonics"),
    "cut off on one side": (lambda: change_channel(1, lambda v: np.minimum(v, 0.7 * v.max())), "outer has harmonics"),
    "cut off by mains": (lambda: change_channel(0, clip(0.85), hum=4e-3), "inner has harmonics"),
    "dead zone": (lambda: change_channel(0, lambda v: np.sign(v) * np.maximum(np.abs(v) - 6e-5, 0)), "inner has harmonics"),
    "load stops": (lambda: np.where(T[:, None] < 5, volts(2), volts(2, turns=0 * T + np.pi / 2)), "amplitude changes"),
    "frequency sweeps": (lambda: volts(3, 2 * np.pi * LOAD * (T + 0.01 * (T - 5) ** 2 / 10)), "phase changes"),
    "rows missing unsaid": (lambda: np.delete(volts(4), np.s_[2000:2020], axis=0), "phase changes"),
    "gain steps": (lambda: change_channel(1, lambda v: v * np.where(T > 3, 1.2, 1)), "beside the others"),
    "force stuck": (lambda: change_channel(2, lambda v: np.where((T > 2) & (T < 3), v[1000], v)), "force changes"),
    "a second load close by": (lambda: change_channel(0, lambda v: v + 3e-4 * np.cos(2 * np.pi * 5.2 * T)), "inner changes"),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_false_waves_are_refused(fault: str) -> None:
    """Each was believed before, 16 to 200 standard deviations off, or for an amplitude that never was."""
    wave, words = REFUSED[fault]
    with pytest.raises(Flawed, match=words) as refused:
        measure_volts(wave())
    assert "\n" not in str(refused.value)


COUNTED: dict[str, Callable[[], Floats]] = {
    "ramp of 1 %": lambda: change_channel(0, lambda v: v * (1 + 0.01 * T / 10)),
    "gain step of 2 %": lambda: change_channel(1, lambda v: v * np.where(T > 6, 1.02, 1)),
    "slightly cut off": lambda: change_channel(0, clip(0.93)),
    "compressed": lambda: change_channel(0, lambda v: v - 0.02 * v**3 / np.abs(v).max() ** 2),
    "dropped out": lambda: change_channel(0, lambda v: np.where((T > 4) & (T < 4.1), 0.0, v)),
    "films exchanged in a frame": lambda: np.where(((T > 4) & (T < 4.02))[:, None], volts(5)[:, [1, 0, 2]], volts(5)),
}


@pytest.mark.parametrize("fault", COUNTED)
def test_small_faults_are_counted_and_told(fault: str) -> None:
    measurement = measure_volts(COUNTED[fault]())
    assert abs(deviation(measurement)) < 2
    assert measurement.warnings
    assert "counted in the uncertainties" in measurement.warnings[-1]


def test_cut_waves_without_a_force_channel_widen_what_both_share() -> None:
    """Both cut at the same share: their ratio is right, their size 2.9 % low, by the integral over the cut peak."""
    angle = np.linspace(0, 2 * np.pi, 100_001)[:-1]
    left = 2 * np.mean(np.clip(np.cos(angle), -0.9, 0.9) * np.cos(angle))
    noise = 1e-6 * np.random.default_rng(1).standard_normal((5000, 3))
    measurement = measure_volts(np.outer(np.clip(np.cos(2 * np.pi * LOAD * T), -0.9, 0.9), TRUE) + noise, sensitivity=None)
    size = np.sqrt(measurement.covariance[0, 0] + measurement.covariance[1, 1]) / abs(measurement.charges[0])
    assert 1 - left < 1.05 * size < 3 * (1 - left)


def test_wandering_mains_leave_the_error_what_it_is() -> None:
    """Mains whose phase walks hide nothing near the load: stated 5 times too wide before."""
    random = np.random.default_rng(5)
    z = []
    for seed in range(8):
        walk = np.cumsum(random.standard_normal(len(T))) * 2 / np.sqrt(RATE)
        z.append(deviation(measure_volts(volts(seed) + np.outer(2e-3 * np.cos(2 * np.pi * 50 * T + walk), [1, 0.7, 0.1]))))
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.6


@pytest.mark.parametrize(("lost", "pieces"), [(1733, 2), (911, 4)])
def test_gaps_of_unknown_length_get_a_phase_each(lost: int, pieces: int) -> None:
    """One sine through all was up to 46 % low."""
    whole = volts(6)
    piece_rows = (len(whole) - (pieces - 1) * lost) // pieces
    rows = [slice(k * (piece_rows + lost), k * (piece_rows + lost) + piece_rows) for k in range(pieces)]
    index = np.concatenate([np.arange(piece_rows) + k * (piece_rows + 1) for k in range(pieces)])
    gaps = tuple(Gap(k * (piece_rows + 1) - 1, -1, "a new acquisition") for k in range(1, pieces))
    measurement = measure_samples(samples(np.concatenate([whole[selection] for selection in rows]), index, gaps), 5.0, 0.1)
    assert abs(measurement.charges * 1e9) == pytest.approx(np.abs(TRUE[:2]), rel=2e-3)
    assert abs(deviation(measurement)) < 3
    assert measurement.fit.seconds == pytest.approx(pieces * (piece_rows - 1) / RATE)


def test_stretches_too_short_are_left_out_and_loads_that_change_between_are_refused() -> None:
    whole = volts(7)
    index = np.arange(5000) + (np.arange(5000) >= 4900)
    short = measure_samples(samples(whole, index, (Gap(4900, -1, "unplugged"),)), 5.0, 0.1)
    assert short.fit.rows == 4900
    assert any("100 samples" in warning for warning in short.warnings)
    index = np.arange(5000) + (np.arange(5000) >= 2500)
    halved = whole * np.where(T < 5, 1, 0.5)[:, None]
    with pytest.raises(Flawed, match="amplitude changes"):
        measure_samples(samples(halved, index, (Gap(2500, -1, "unplugged"),)), 5.0, 0.1)


@pytest.mark.parametrize(("rate", "load"), [(45.0, 5.0), (55.0, 5.0), (105.0, 5.0), (48.0, 2.0), (40.3, 9.9)])
def test_rates_at_which_the_mains_look_like_the_load_are_refused(rate: float, load: float) -> None:
    t = np.arange(2000) / rate
    wave = np.cos(2 * np.pi * load * t)[:, None] * TRUE + 1e-5 * np.random.default_rng(1).standard_normal((2000, 3))
    with pytest.raises(NoSine, match="read at another rate"):
        fit_sine(samples(wave, rate=rate), load)


@pytest.mark.parametrize("true", [500.0 * 1.03, 500.0 / 1.04, 500.0 * 1.005])
def test_mains_show_a_wrong_sample_rate(true: float) -> None:
    """Taken at another rate than stated, the load and the mains are off alike."""
    t = np.arange(5000) / true
    wave = np.cos(2 * np.pi * LOAD * t)[:, None] * TRUE + 4e-4 * np.cos(2 * np.pi * 50.01 * t)[:, None]
    measurement = measure_volts(wave + 1e-5 * np.random.default_rng(2).standard_normal((5000, 3)))
    assert any("the sample rate may be in error" in warning for warning in measurement.warnings)


def test_anything_not_a_number_is_refused() -> None:
    for value in (np.nan, np.inf):
        with pytest.raises(HardwareError, match="no numbers"):
            measure_volts(change_channel(0, lambda v, value=value: np.where(T[77] == T, value, v)))


def test_one_signal_in_both_channels_is_refused() -> None:
    whole = volts(1)
    with pytest.raises(NoSine, match="hold the same numbers"):
        measure_volts(whole[:, [0, 0, 2]])


def test_steady_blocks_are_called_unsteady_as_seldom_as_stated() -> None:
    """Noise alone widens nothing: 5 tests of 1e-4 each."""
    assert sum(bool(measure_volts(volts(seed, hum=0.0)).warnings) for seed in range(12)) == 0


def test_channels_that_are_not_used_do_not_matter() -> None:
    wild = change_channel(2, lambda v: np.cumsum(np.sign(v)))
    assert abs(deviation(measure_volts(wild, sensitivity=None))) < 3
    assert replace(samples(wild), gaps=()).select_channels(("outer",)).volts.shape == (5000, 1)
