"""A reading in stresses: against true forces, error budgets done by hand, and what is null."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from geometry.scenes.scene_tables import Load
from hw.signal.measurement import Measurement
from hw.signal.waveform import Flawed
from probe_design.built_probe.bench import Reference
from probe_design.built_probe.block_predictions import BlockPrediction
from probe_design.built_probe.film_forces import bound_warming, measure_samples
from probe_design.built_probe.gains import Gains
from probe_design.built_probe.reading import StressReading, compute_reading, predict_scene
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals
from solver.results.result import Result
from tests.support.hw.benches import BENCH, LOAD, films, sampled, scene, shares

EXACT = BuiltProperties(
    gains=((1.0, 0.0), (0.0, 1.0)),
    resistance=(1.0, 1.0),
    capacitance=(1.0, 1.0),
    force=1.0,
    frequency=1.0,
    offsets=(0.0, 0.0, 0.0),
)
AREAS = np.array([scene().probe.inner_area, scene().probe.outer_area])


def measured(forces: Floats, built: BuiltProperties = EXACT, calibrated_at: float | None = None) -> Measurement:
    return measure_samples(sampled(build_signals(built, BENCH, scene(), forces, 1)), BENCH, calibrated_at)


def make_prediction(ratio: float, error: float = 1e-3) -> Result:
    """A prediction that states the numbers it was given."""
    outer = LOAD / (AREAS[1] + ratio * AREAS[0])
    return Result("none", 0.0, stress_inner=ratio * outer, stress_outer=outer, ratio=ratio, error_estimate=error)


@pytest.fixture(scope="module")
def forces() -> Floats:
    return films(shares().log_ratios)[4]


def test_stresses_are_forces_over_nominal_areas(forces: Floats) -> None:
    known = Gains(np.eye(2), np.zeros((4, 4)), np.zeros((4, 0)), np.zeros(0), True, (True, True))
    reading = compute_reading(measured(forces), scene(), BENCH, make_prediction(0.6), known)
    stress = forces / AREAS
    assert reading.stress_inner == pytest.approx(stress[0], rel=2e-3)
    assert reading.stress_outer == pytest.approx(stress[1], rel=2e-3)
    assert reading.ratio == pytest.approx(stress[0] / stress[1], rel=2e-3)
    assert reading.force == pytest.approx(LOAD, rel=2e-3)
    assert reading.reference_force == pytest.approx(LOAD, rel=2e-3)


def test_prediction_is_scaled_to_the_force_that_was_read(forces: Floats) -> None:
    pressed = scene().model_copy(update={"load": Load(force=3 * LOAD)})
    reading = compute_reading(measured(3 * forces), pressed, BENCH, make_prediction(0.6))
    assert reading.predicted_stress_inner == pytest.approx(3 * (make_prediction(0.6).stress_inner or 0.0), rel=2e-3)
    without_force = BENCH.model_copy(update={"force": None})
    alone = compute_reading(replace(measured(3 * forces), force=None), pressed, without_force, make_prediction(0.6))
    assert alone.predicted_stress_inner == make_prediction(0.6).stress_inner
    assert alone.reference_force is None


def test_error_budget_without_calibration(forces: Floats) -> None:
    """Gain 5 %, Cf 2 %, cross-talk 1 % of the other film's force; the ratio has two of each."""
    reading = compute_reading(measured(forces), scene(), BENCH, make_prediction(0.6))
    inner, outer = (math.hypot(0.05, 0.02, 0.01 * forces[1 - k] / forces[k]) for k in (0, 1))
    assert reading.stress_inner_uncertainty / reading.stress_inner == pytest.approx(inner, rel=0.02)
    assert reading.stress_outer_uncertainty / reading.stress_outer == pytest.approx(outer, rel=0.02)
    assert reading.ratio
    assert reading.ratio_uncertainty
    assert reading.ratio_uncertainty / reading.ratio == pytest.approx(math.hypot(inner, outer) / (1 - outer), rel=0.02)


def test_z_counts_both_sides(forces: Floats) -> None:
    known = Gains(np.eye(2), np.zeros((4, 4)), np.zeros((4, 0)), np.zeros(0), True, (True, True))
    truth = float(forces[0] / forces[1] * AREAS[1] / AREAS[0])
    reading = compute_reading(
        measured(forces, calibrated_at=5.0), scene(), BENCH, make_prediction(truth * 1.02, error=0.02 * math.sqrt(3)), known
    )
    assert reading.z_ratio == pytest.approx(-1.0, abs=0.05)


def test_ratio_is_null_where_the_outer_stress_is_below_its_error(forces: Floats) -> None:
    reading = compute_reading(measured(np.array([LOAD, 1e-4])), scene(), BENCH, make_prediction(0.6))
    assert (reading.ratio, reading.ratio_uncertainty, reading.z_ratio) == (None, None, None)
    assert any("null" in warning for warning in reading.warnings)


def test_null_predictions_are_passed_on(forces: Floats) -> None:
    reading = compute_reading(measured(forces), scene(), BENCH, Result("none", 0.0))
    assert reading.ratio
    assert (reading.predicted_ratio, reading.predicted_stress_inner, reading.z_ratio, reading.z_stress_outer) == (None,) * 4


def test_prediction_takes_the_fast_level() -> None:
    assert predict_scene(scene(), 0.01).evaluator == "axisymmetric"


def test_steady_warming_shows_as_an_offset(forces: Floats) -> None:
    """1 mK/s on the outer film: V = Rf p A dT/dt, and 5 s of it are 5 mK."""
    volts = 1e9 * 30e-6 * AREAS[1] * 1e-3
    measurement = measured(forces, replace(EXACT, offsets=(0.0, volts, 0.0), drift=0.0))
    assert bound_warming(measurement, BENCH, scene().probe)[1] == pytest.approx(5e-3, rel=0.02)


def test_share_s_variance_has_block_and_solver() -> None:
    """Evenly spread within +-b: b^2 / 3."""
    share = BlockPrediction(log_ratio=0.0, bound=0.03, derivatives=np.zeros(0), modulus_derivative=0.5)
    assert share.compute_variance(Reference(youngs_modulus=1e3, tolerance=0.02)) == pytest.approx(0.01**2 + 0.03**2 / 3)


def test_a_dead_inner_film_is_refused(forces: Floats) -> None:
    """A ratio of nearly 0 was stated with an error of 0.02 %, with the cross-talk of the living film in it or without."""
    for share in (0.0, 0.004):
        measurement = measured(np.array([share, 1.0]) * forces.sum())
        for bench in (BENCH, BENCH.model_copy(update={"force": None})):
            with pytest.raises(Flawed, match=r"the inner film shows .* is it dead"):
                compute_reading(
                    replace(measurement, force=measurement.force if bench.force else None), scene(), bench, make_prediction(0.6)
                )


def test_a_film_of_reversed_polarity_is_refused(forces: Floats) -> None:
    with pytest.raises(Flawed, match="the inner film shows tension"):
        compute_reading(measured(forces * [-1.0, 1.0]), scene(), BENCH, make_prediction(0.6))


def test_films_that_contradict_the_force_channel_are_refused(forces: Floats) -> None:
    """A film whose gain has halved since the calibration: 18 % of the sum, where 2.5 % are 5 standard deviations."""
    halved = replace(EXACT, gains=((0.5, 0.0), (0.0, 1.0)))
    known = Gains(np.eye(2), np.zeros((4, 4)), np.zeros((4, 0)), np.zeros(0), True, (True, True))
    with pytest.raises(Flawed, match=r"the force channel 0\.1"):
        compute_reading(measured(forces, halved, calibrated_at=5.0), scene(), BENCH, make_prediction(0.6), known)


def test_what_the_waveform_adds_is_told(forces: Floats) -> None:
    ramp = sampled(build_signals(EXACT, BENCH, scene(), forces, 1))
    ramp.volts[:, 1] *= np.linspace(1.0, 1.02, len(ramp))
    result = compute_reading(measure_samples(ramp, BENCH), scene(), BENCH, make_prediction(0.6))
    assert any("channel outer changes" in warning for warning in result.warnings)


def test_what_nearly_contradicts_the_force_channel_is_told(forces: Floats) -> None:
    """Uncalibrated, a gain 1.5 times too large makes a ratio 4 standard deviations off, the films' sum as many."""
    louder = replace(EXACT, gains=((1.5, 0.0), (0.0, 1.0)))
    reading = compute_reading(measured(forces, louder), scene(), BENCH, make_prediction(0.6))
    assert any("standard deviations apart" in warning for warning in reading.warnings)


@pytest.mark.parametrize("force", [True, False])
@pytest.mark.parametrize(("factor", "slip"), [(1e3, "millivolts taken as volts"), (1e-3, "volts taken as millivolts"), (50, "")])
def test_a_load_that_nobody_presses_is_refused(forces: Floats, force: bool, factor: float, slip: str) -> None:
    """Films and force channel agree with each other, or there is none: only the scene's load shows the unit."""
    with pytest.raises(InputError, match=rf"load read = .* times|1/.* of.*{slip}"):
        _at_force(forces, factor, force)


@pytest.mark.parametrize("force", [True, False])
@pytest.mark.parametrize(("factor", "words"), [(10.0, "10:1 probe factor"), (0.1, "1:10 probe factor"), (3.0, "3 times")])
def test_a_doubtful_load_is_told(forces: Floats, force: bool, factor: float, words: str) -> None:
    assert any(words in warning for warning in _at_force(forces, factor, force).warnings)


@pytest.mark.parametrize("force", [True, False])
@pytest.mark.parametrize("factor", [0.6, 1.0, 1.7])
def test_a_load_of_about_the_scene_s_is_not_remarked_on(forces: Floats, force: bool, factor: float) -> None:
    assert not any("to be pressed" in warning for warning in _at_force(forces, factor, force).warnings)


@pytest.mark.parametrize("force", [True, False])
def test_a_prescribed_indentation_tells_the_load_by_the_stiffness(forces: Floats, force: bool) -> None:
    with pytest.raises(InputError, match="millivolts"):
        _at_force(forces, 1e3, force, Load(indentation=1e-4), replace(make_prediction(0.6), stiffness=LOAD / 1e-4))


def test_no_load_at_all_is_held_against_the_tissue_s_depth(forces: Floats) -> None:
    """k d with k = 100 N/m and d = 30 mm: 3 N would press the probe through it, whatever the scene's load is."""
    unloaded, soft = Load(force=0.0), replace(make_prediction(0.6), stiffness=100.0)
    assert not any("to be pressed" in warning for warning in _at_force(forces, 1.0, False, unloaded, soft).warnings)
    with pytest.raises(InputError, match="through the tissue"):
        _at_force(forces, 1e3, False, unloaded, soft)


def test_films_of_another_unit_than_the_force_channel_are_told(forces: Floats) -> None:
    pressed = scene().model_copy(update={"load": Load(force=LOAD)})
    measurement = measured(forces)
    with pytest.raises(InputError, match="millivolts taken as volts"):
        compute_reading(replace(measurement, charges=1e3 * measurement.charges), pressed, BENCH, make_prediction(0.6))


def _at_force(
    forces: Floats, factor: float, force: bool, load: Load | None = None, predicted: Result | None = None
) -> StressReading:
    """Read a slip of units by ``factor``, with the force channel or without, on a scene of LOAD unless it has another."""
    pressed = scene().model_copy(update={"load": load or Load(force=LOAD)})
    bench = BENCH if force else BENCH.model_copy(update={"force": None})
    measurement = measured(forces)
    scaled = {"charges": factor * measurement.charges} | {
        name: factor**2 * getattr(measurement, name) for name in ("covariance", "tolerance")
    }
    shown = {"force": factor * (measurement.force or 0.0) if force else None}
    return compute_reading(replace(measurement, **scaled, **shown), pressed, bench, predicted or make_prediction(0.6))


def test_exchanged_channels_are_told_where_the_prediction_shows_them(forces: Floats) -> None:
    ratio = float(forces[0] / AREAS[0] / (forces[1] / AREAS[1]))
    right, turned = (compute_reading(measured(item), scene(), BENCH, make_prediction(ratio)) for item in (forces, forces[::-1]))
    assert not any("exchanged" in item for item in right.warnings)
    assert any("exchanged" in item for item in turned.warnings)
