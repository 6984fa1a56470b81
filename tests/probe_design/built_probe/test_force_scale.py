"""The force channel's scale: a sensor that is off lies within what is stated, and a known load settles it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geometry.common.arrays import Floats
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.film_forces import reading
from probe_design.built_probe.force_scale import mean_gain_sd, scale_warnings
from probe_design.built_probe.gain_matrix import Gains, Observed, estimated
from probe_design.built_probe.reading import read
from probe_design.built_probe.virtual_probe import Built, signals
from solver.results.result import Result
from tests.support.hw.benches import BENCH, LOAD, films, sampled, scene, shares

TRUTH = np.array([[1.03, 0.012], [0.008, 0.97]])
NOISE = 2e-5  # N
VERIFIED = BENCH.model_copy(update={"force": BENCH.force and BENCH.force.model_copy(update={"verified": True})})


def known_load(tolerance: float = 0.005) -> Bench:
    pin, *rest = BENCH.reference
    known = pin.model_copy(update={"known_force": LOAD, "known_force_tolerance": tolerance})
    return BENCH.model_copy(update={"reference": (known, *rest)})


def gains(bench: Bench, scale: float | None, truth: Floats = TRUTH) -> Gains:
    """From readings without noise; the force channel shows ``scale`` times the load, or there is none."""
    pressed = zip(bench.reference, films(shares().log_ratios, bench), strict=True)
    force = (None, None) if scale is None else (scale * LOAD, 1e-4 * LOAD)
    seen = [Observed(one, truth @ film, NOISE**2 * np.eye(2), *force) for one, film in pressed]
    return estimated(seen, shares(), bench)


def off(found: Gains) -> Floats:
    """Errors of both gains over their standard deviations."""
    return ((found.matrix - TRUTH).ravel() / np.sqrt(np.diag(found.covariance)))[[0, 3]]


@pytest.mark.parametrize("scale", [0.8, 0.9, 1.0, 1.1, 1.25])
def test_a_sensor_that_nothing_confirms_is_counted(scale: float) -> None:
    """Ten per cent high, gains came out 0.937 and 0.883 for 1.03 and 0.97, told to 0.5 %."""
    found = gains(BENCH, scale)
    assert np.abs(off(found)).max() < 0.2
    assert found.force_scale.factor == pytest.approx(scale, rel=0.01)
    assert found.force_scale.sd == pytest.approx(mean_gain_sd(BENCH), rel=0.05)
    (warning,) = scale_warnings(found.force_scale, BENCH)
    assert "known_force" in warning


def test_the_films_nominal_gains_are_the_scale_s_measure() -> None:
    """Gains of 1 +- 5 % whose capacitors are 1 +- 2 %: their mean is known to hypot(5, 2) / sqrt(2) %."""
    assert mean_gain_sd(BENCH) == pytest.approx(np.hypot(0.05, 0.02) / np.sqrt(2))


def test_the_ratio_does_not_depend_on_the_sensor() -> None:
    """What is read of a ratio, and how well it is told, is the same whatever the sensor shows."""
    readings, spreads = [], []
    for bench, scale in ((BENCH, 1.1), (BENCH, 0.9), (VERIFIED, 1.0)):
        found = gains(bench, scale)
        forces = found.forces(TRUTH @ (LOAD * np.array([0.4, 0.6])))
        slopes = np.array([1.0, -1.0]) / forces
        readings.append(forces[0] / forces[1])
        covariance = found.forces_covariance(TRUTH @ (LOAD * np.array([0.4, 0.6])), np.zeros((2, 2)))
        spreads.append(np.sqrt(slopes @ covariance @ slopes))
    assert readings == pytest.approx([2 / 3] * 3, rel=2e-3)
    assert spreads == pytest.approx([spreads[0]] * 3, rel=0.06)


@pytest.mark.parametrize("scale", [0.9, 1.0, 1.1])
def test_a_known_load_on_the_pin_settles_the_scale(scale: float) -> None:
    found = gains(known_load(), scale)
    assert np.abs(off(found)).max() < 0.5
    assert found.force_scale.factor == pytest.approx(scale, rel=2e-3)
    assert found.force_scale.sd == pytest.approx(0.005, rel=0.05)
    assert np.sqrt(found.covariance[3, 3]) < 0.01
    warnings = scale_warnings(found.force_scale, known_load())
    assert len(warnings) == (scale != 1.0)
    assert all("10 %" in one and "known load" in one for one in warnings)


def test_a_known_load_replaces_the_force_channel() -> None:
    """Of the inner film; the outer one's gain follows by the blocks, as well as these are predicted."""
    found = gains(known_load(), None)
    assert found.absolute
    assert np.abs(off(found)).max() < 0.5
    assert np.sqrt(np.diag(found.covariance)[[0, 3]]) == pytest.approx([0.0076, 0.026], rel=0.2)


def test_a_confirmed_sensor_is_believed() -> None:
    found = gains(VERIFIED, 1.0)
    assert np.sqrt(np.diag(found.covariance)[[0, 3]]) == pytest.approx([0.005, 0.005], rel=0.5)
    assert scale_warnings(found.force_scale, VERIFIED) == []


@pytest.mark.parametrize("bench", [BENCH, known_load()])
def test_a_reading_with_the_same_sensor_agrees_with_its_calibration(bench: Bench) -> None:
    """The sensor is 10 % high: films and force agree as calibrated, and stresses lie within what is stated."""
    built = Built(force=1.1, gains=((1.03, 0.012), (0.008, 0.97)), resistance=(1, 1), capacitance=(1, 1), offsets=(0, 0, 0))
    forces = films(shares().log_ratios)[4]
    measured = reading(sampled(signals(built, BENCH, scene(), forces, 5)), BENCH, 5.0)
    pressed = scene().model_copy(update={"load": scene().load.model_copy(update={"force": LOAD})})
    known = gains(bench, 1.1)
    found = read(measured, pressed, BENCH, Result("none", 0.0), known)
    assert not any("standard deviations apart" in one for one in found.warnings)
    assert found.reference_force == pytest.approx(LOAD, abs=2 * known.force_scale.sd * LOAD)
    assert abs(found.force - LOAD) < 1.96 * found.force_uncertainty
    # a film that has lost 2 % since is told: what calibration and reading share hides nothing
    weaker = replace(built, gains=((1.008, 0.012), (0.008, 0.95)))
    later = reading(sampled(signals(weaker, BENCH, scene(), forces, 5)), BENCH, 5.0)
    told = read(later, pressed, BENCH, Result("none", 0.0), known)
    assert any("standard deviations apart" in one for one in told.warnings)
