"""Phases between the films: cross-talk of either sign is no lag, and a film that lags is named with its readings."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from geometry import InputError
from hw.common.samples import Samples
from probe_design.built_probe.calibration import Calibration
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals
from tests.support.hw.benches import BENCH, calibrate, films, sampled, scene, shares

RATE = 2000.0
NAMES = [reference.name for reference in BENCH.reference]


STILL = BuiltProperties(drift=0.0)


def readings(built: BuiltProperties = STILL, channels: int = 3) -> list[Samples]:
    forces = films(shares().log_ratios)
    pressed = [build_signals(built, BENCH, scene(), force, [21, k]) for k, force in enumerate(forces)]
    return [sampled(force, rows=10_000, rate=RATE, channels=channels) for force in pressed]


def late(samples: Samples, film: int, rows: int = 4) -> Samples:
    volts = samples.volts.copy()
    volts[:, film] = np.roll(volts[:, film], rows)  # whole periods: nothing jumps but the drift
    return replace(samples, volts=volts)


def list_lag_warnings(calibration: Calibration) -> list[str]:
    return [warning for warning in calibration.warnings if "film lags" in warning]


@pytest.mark.parametrize("cross", [(-0.012, -0.008), (-0.012, 0.008), (0.012, 0.008), (0.0, -1e-4)])
@pytest.mark.parametrize("channels", [2, 3])
def test_cross_talk_of_either_sign_is_no_lag(cross: tuple[float, float], channels: int) -> None:
    """Of a negative one the phase is pi: 71 % of good calibrations were reported to differ by 2.8 rad."""
    built = BuiltProperties(gains=((1.02, cross[0]), (cross[1], 0.97)), drift=0.0)
    fitted = calibrate(scene(), BENCH, readings(built, channels), shares())
    assert not any("lag" in warning or "phase" in warning for warning in fitted.warnings)


@pytest.mark.parametrize(("film", "name"), [(0, "inner"), (1, "outer")])
def test_a_film_that_lags_is_named_with_its_reading(film: int, name: str) -> None:
    samples = readings()
    samples[4] = late(samples[4], film, 3)
    (warning,) = list_lag_warnings(calibrate(scene(), BENCH, samples, shares()))
    assert warning.startswith(f"{NAMES[4]}: the {name} film lags")
    assert f"the {name} film is out of phase with the force channel" in warning
    (rad,) = re.findall(r"by up to (\S+) rad", warning)
    assert float(rad) == pytest.approx(3 / RATE * 2 * math.pi * 5, abs=0.006)  # the amplifiers' resistors turn it by 0.002


@pytest.mark.slow
def test_a_lag_that_makes_readings_contradict_each_other_is_named_too() -> None:
    samples = readings()
    samples[4] = late(samples[4], 1)
    with pytest.raises(InputError, match=f"{NAMES[4]}: the outer film lags"):
        calibrate(scene(), BENCH, samples, shares())


@pytest.mark.parametrize("channels", [2, 3])
def test_a_film_that_lags_in_all_readings_is_one_warning(channels: int) -> None:
    samples = [late(reading, 1) for reading in readings(channels=channels)]
    (warning,) = list_lag_warnings(calibrate(scene(), BENCH, samples, shares()))
    assert all(name in warning for name in NAMES[2:])
    assert "the outer film lags" in warning


def test_a_known_skew_of_the_channels_is_no_lag() -> None:
    """The outer channel is sampled 2 ms later than the inner one, so that its film leads."""
    samples = [late(reading, 1, -4) for reading in readings()]
    assert list_lag_warnings(calibrate(scene(), BENCH, samples, shares()))
    known = BENCH.model_copy(update={"sampling": BENCH.sampling.model_copy(update={"skew": 4 / RATE})})
    assert not list_lag_warnings(calibrate(scene(), known, samples, shares()))
