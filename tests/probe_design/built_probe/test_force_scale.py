"""The force channel's scale: a sensor that is off lies within what is stated, and a known load settles it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geometry.common.arrays import Floats
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.calibration import list_scale_warnings
from probe_design.built_probe.film_forces import measure_samples
from probe_design.built_probe.gain_fit import compute_mean_gain_sd, estimate_gains
from probe_design.built_probe.gains import Gains, Observation
from probe_design.built_probe.reading import compute_reading
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals
from solver.results.result import Result
from tests.support.hw.benches import BENCH, LOAD, films, sampled, scene, shares

TRUTH = np.array([[1.03, 0.012], [0.008, 0.97]])
NOISE = 2e-5  # N
VERIFIED = BENCH.model_copy(update={"force": BENCH.force and BENCH.force.model_copy(update={"verified": True})})


def known_load(tolerance: float = 0.005) -> Bench:
    pin, *references = BENCH.reference
    known = pin.model_copy(update={"known_force": LOAD, "known_force_tolerance": tolerance})
    return BENCH.model_copy(update={"reference": (known, *references)})


def gains(bench: Bench, scale: float | None, truth: Floats = TRUTH) -> Gains:
    """From readings without noise; the force channel shows ``scale`` times the load, or there is none."""
    pressed = zip(bench.reference, films(shares().log_ratios, bench), strict=True)
    force = (None, None) if scale is None else (scale * LOAD, 1e-4 * LOAD)
    seen = [Observation(observed_item, truth @ film, NOISE**2 * np.eye(2), *force) for observed_item, film in pressed]
    return estimate_gains(seen, shares(), bench)


def find_error(fitted: Gains) -> Floats:
    """Errors of both gains over their standard deviations."""
    return ((fitted.matrix - TRUTH).ravel() / np.sqrt(np.diag(fitted.covariance)))[[0, 3]]


@pytest.mark.parametrize("scale", [0.8, 0.9, 1.0, 1.1, 1.25])
def test_a_sensor_that_nothing_confirms_is_counted(scale: float) -> None:
    """Ten per cent high, gains came out 0.937 and 0.883 for 1.03 and 0.97, with a stated error of 0.5 %."""
    fitted = gains(BENCH, scale)
    assert np.abs(find_error(fitted)).max() < 0.2
    assert fitted.force_scale.factor == pytest.approx(scale, rel=0.01)
    assert fitted.force_scale.sd == pytest.approx(compute_mean_gain_sd(BENCH), rel=0.05)
    (warning,) = list_scale_warnings(fitted.force_scale, BENCH)
    assert "known_force" in warning


def test_the_films_nominal_gains_are_the_scale_s_measure() -> None:
    """Gains of 1 +- 5 % whose capacitors are 1 +- 2 %: their mean is known to hypot(5, 2) / sqrt(2) %."""
    assert compute_mean_gain_sd(BENCH) == pytest.approx(np.hypot(0.05, 0.02) / np.sqrt(2))


def test_the_ratio_does_not_depend_on_the_sensor() -> None:
    """A ratio that is read, and its stated error, are the same whatever the sensor shows."""
    readings, spreads = [], []
    for bench, scale in ((BENCH, 1.1), (BENCH, 0.9), (VERIFIED, 1.0)):
        fitted = gains(bench, scale)
        forces = fitted.compute_forces(TRUTH @ (LOAD * np.array([0.4, 0.6])))
        slopes = np.array([1.0, -1.0]) / forces
        readings.append(forces[0] / forces[1])
        covariance = fitted.compute_forces_covariance(TRUTH @ (LOAD * np.array([0.4, 0.6])), np.zeros((2, 2)))
        spreads.append(np.sqrt(slopes @ covariance @ slopes))
    assert readings == pytest.approx([2 / 3] * 3, rel=2e-3)
    assert spreads == pytest.approx([spreads[0]] * 3, rel=0.06)


@pytest.mark.parametrize("scale", [0.9, 1.0, 1.1])
def test_a_known_load_on_the_pin_settles_the_scale(scale: float) -> None:
    fitted = gains(known_load(), scale)
    assert np.abs(find_error(fitted)).max() < 0.5
    assert fitted.force_scale.factor == pytest.approx(scale, rel=2e-3)
    assert fitted.force_scale.sd == pytest.approx(0.005, rel=0.05)
    assert np.sqrt(fitted.covariance[3, 3]) < 0.01
    warnings = list_scale_warnings(fitted.force_scale, known_load())
    assert len(warnings) == (scale != 1.0)
    assert all("10 %" in warning and "known load" in warning for warning in warnings)


def test_a_known_load_replaces_the_force_channel() -> None:
    """Of the inner film; the outer one's gain follows by the blocks, as well as these are predicted."""
    fitted = gains(known_load(), None)
    assert fitted.absolute
    assert np.abs(find_error(fitted)).max() < 0.5
    assert np.sqrt(np.diag(fitted.covariance)[[0, 3]]) == pytest.approx([0.0076, 0.026], rel=0.2)


def test_a_confirmed_sensor_is_believed() -> None:
    fitted = gains(VERIFIED, 1.0)
    assert np.sqrt(np.diag(fitted.covariance)[[0, 3]]) == pytest.approx([0.005, 0.005], rel=0.5)
    assert list_scale_warnings(fitted.force_scale, VERIFIED) == []


@pytest.mark.parametrize("bench", [BENCH, known_load()])
def test_a_reading_with_the_same_sensor_agrees_with_its_calibration(bench: Bench) -> None:
    """The sensor is 10 % high: films and force agree as calibrated, and stresses lie within what is stated."""
    built = BuiltProperties(
        force=1.1, gains=((1.03, 0.012), (0.008, 0.97)), resistance=(1, 1), capacitance=(1, 1), offsets=(0, 0, 0)
    )
    forces = films(shares().log_ratios)[4]
    measured = measure_samples(sampled(build_signals(built, BENCH, scene(), forces, 5)), BENCH, 5.0)
    pressed = scene().model_copy(update={"load": scene().load.model_copy(update={"force": LOAD})})
    known = gains(bench, 1.1)
    probe_reading = compute_reading(measured, pressed, BENCH, Result("none", 0.0), known)
    assert not any("standard deviations apart" in warning for warning in probe_reading.warnings)
    assert probe_reading.reference_force == pytest.approx(LOAD, abs=2 * known.force_scale.sd * LOAD)
    assert abs(probe_reading.force - LOAD) < 1.96 * probe_reading.force_uncertainty
    # a film that has lost 2 % since is told: what calibration and reading share hides nothing
    weaker = replace(built, gains=((1.008, 0.012), (0.008, 0.95)))
    later = measure_samples(sampled(build_signals(weaker, BENCH, scene(), forces, 5)), BENCH, 5.0)
    later_reading = compute_reading(later, pressed, BENCH, Result("none", 0.0), known)
    assert any("standard deviations apart" in warning for warning in later_reading.warnings)
