"""A wrong sampling rate: detected by the drive's frequency, and counted where the amplifiers are divided out at the wrong one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hw.common.samples import Samples
from hw.signal.measurement import Measurement
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.film_forces import compute_film_forces, measure_samples
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals
from tests.support.hw.benches import BENCH, calibrate, films, sampled, scene, shares

EXACT = BuiltProperties(
    gains=((1.0, 0.0), (0.0, 1.0)), resistance=(1, 1), capacitance=(1, 1), force=1.0, frequency=1.0, hum=0.0, drift=0.0
)
FORCES = films(shares().log_ratios)[4]


def slow(frequency: float) -> Bench:
    load = BENCH.load.model_copy(update={"frequency": frequency})
    amplifier = BENCH.amplifier.model_copy(update={"resistance_tolerance": 0.0, "capacitance_tolerance": 0.0})
    return BENCH.model_copy(update={"load": load, "amplifier": amplifier})


def at_rate(bench: Bench, factor: float, rows: int = 20_000) -> Samples:
    """Samples whose stated rate is ``factor`` times the true one."""
    taken = sampled(build_signals(EXACT, bench, scene(), FORCES, 3), rows=rows, rate=400.0)
    return replace(taken, rate=factor * taken.rate)


def measured(bench: Bench, factor: float) -> Measurement:
    return measure_samples(at_rate(bench, factor), bench)


@pytest.mark.parametrize("factor", [0.9, 0.97, 0.995, 1.005, 1.03, 1.1])
def test_a_wrong_rate_without_mains_is_told(factor: float) -> None:
    (warning,) = (text for text in measured(slow(5.0), factor).warnings if "sampling rate" in text)
    assert f"{abs(100 * (factor - 1)):.2g} %" in warning


@pytest.mark.parametrize("factor", [1.0, 1.0005, 0.9985])
def test_a_rate_within_the_drive_s_tolerance_is_not(factor: float) -> None:
    assert not any("sampling rate" in warning for warning in measured(slow(5.0), factor).warnings)


@pytest.mark.parametrize("frequency", [0.2, 0.5, 5.0])
@pytest.mark.parametrize("factor", [0.95, 1.05])
def test_what_it_does_to_the_amplifiers_is_counted(frequency: float, factor: float) -> None:
    """Near the corner of 0.16 Hz, 5 % of frequency are 2 % of charge."""
    bench = slow(frequency)
    films_read, spread = compute_film_forces(measured(bench, factor), scene(), tolerance=True)
    errors = np.abs(films_read - FORCES)
    assert np.all(errors < 1.96 * np.sqrt(np.diag(spread)))
    if frequency < 1:
        noise = np.sqrt(np.diag(compute_film_forces(measured(bench, factor), scene())[1]))
        assert np.all(errors > 2 * noise)  # which is what was stated


@pytest.mark.slow
def test_gains_count_it_too() -> None:
    """All readings are divided by the same wrong response: 0.5 Hz read as 0.525 Hz makes gains 0.5 % too small."""
    bench, factor = slow(0.5), 1.05
    force = bench.force and bench.force.model_copy(update={"verified": True, "tolerance": 1e-4})
    bench = bench.model_copy(update={"force": force})
    pressed = films(shares().log_ratios)
    taken = [
        sampled(build_signals(EXACT, bench, scene(), item, [3, k]), rows=20_000, rate=400.0) for k, item in enumerate(pressed)
    ]
    good, wrong = (
        calibrate(scene(), bench, [replace(item, rate=turn * item.rate) for item in taken], shares()) for turn in (1.0, factor)
    )
    errors = np.abs(np.diag(wrong.gains.matrix) - np.diag(good.gains.matrix))
    assert np.all(errors > 2e-3)
    assert np.all(errors < 1.96 * np.sqrt(np.diag(wrong.gains.covariance)[[0, 3]]))
    assert any("sampling rate" in item for item in wrong.warnings)
    assert not any("sampling rate" in item for item in good.warnings)
