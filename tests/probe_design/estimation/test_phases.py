"""Phases of readings: what is read of files, predicted of lossy scenes, and believed."""

from __future__ import annotations

import cmath
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from geometry import InputError, Scene, read_scene
from probe_design.estimation.estimate import estimate
from probe_design.estimation.measurements import Measurements, Reading, read_readings
from probe_design.estimation.model import TargetModel
from probe_design.estimation.predictions import THIRD_ORDER_FACTOR, select_usable
from solver.axisymmetric.refinement import MESH_LEVELS
from solver.phase.losses import compute_angle_spread
from tests.support.complex_states import complex_ratio
from tests.support.paths import EXAMPLES

SD = 2e-3


@cache
def lossy(tissue: float = 0.2) -> Scene:
    return read_scene(EXAMPLES / "scene.toml").replace({"tissue.loss_factor": tissue, "inclusion.loss_factor": tissue / 2})


def read_at(phase: float | None, sd: float | None = SD, noise: float = 0.01) -> tuple[Reading, ...]:
    return (Reading(0.0, 0.0, 0.563, noise, ratio_phase=phase, ratio_phase_sd=None if phase is None else sd),)


def written(folder: Path, text: str) -> tuple[Reading, ...]:
    path = folder / "readings.csv"
    path.write_text(text)
    return read_readings(path, lossy())


def test_phases_are_read_in_degrees_or_radians(tmp_path: Path) -> None:
    rows = "ratio,noise,ratio_phase,ratio_phase_sd\n0.56,0.01,1.8 deg,0.1 deg\n0.56,0.01,-0.03,0.002\n0.56,0.01,,\n"
    first, second, third = written(tmp_path, rows)
    assert (first.ratio_phase, first.ratio_phase_sd) == pytest.approx((math.radians(1.8), math.radians(0.1)))
    assert (second.ratio_phase, second.ratio_phase_sd) == (-0.03, 0.002)
    assert third.ratio_phase is third.ratio_phase_sd is None


@pytest.mark.parametrize(
    ("cells", "key"),
    [
        ("1.8 deg,", "ratio_phase_sd"), (",0.1 deg", "ratio_phase"), ("1.8 mm,0.1 deg", "ratio_phase"),
        ("1.8 deg,0", "ratio_phase_sd"), ("170 deg,1 deg", "ratio_phase"), ("nan,0.1", "ratio_phase"),
    ],
)  # fmt: skip
def test_phases_that_are_none_are_refused(tmp_path: Path, cells: str, key: str) -> None:
    with pytest.raises(InputError, match=rf"reading\[0\]\.{key} = "):
        written(tmp_path, f"ratio,noise,ratio_phase,ratio_phase_sd\n0.56,0.01,{cells}\n")


def test_what_the_model_cannot_use_is_left_out_and_said() -> None:
    data = Measurements.from_readings(read_at(0.03))
    assert select_usable(lossy(), data) == (data, ())
    left, notes = select_usable(read_scene(EXAMPLES / "scene.toml"), data)
    assert not left.is_phase.any()
    assert "every loss factor of the scene is 0" in notes[0]
    left, notes = select_usable(lossy(), Measurements.from_readings(read_at(0.03, 1e-4)))
    assert not left.is_phase.any()
    assert "predicted within" in notes[0]


@pytest.mark.slow
def test_predictions_are_phases_of_the_complex_equations() -> None:
    """Within the bound, mostly of what eq. ES.9 leaves out; the derivative is that of bodies a little softer and stiffer."""
    scene = lossy()
    model = TargetModel(scene, Measurements.from_readings(read_at(0.03)), 3e-3)
    predicted = model.predict({"youngs_modulus": 30e3 * np.array([1 / 1.2, 1.0, 1.2])})
    assert abs(predicted.value[1, 1] - cmath.phase(complex_ratio(scene, MESH_LEVELS[1]))) <= predicted.bound[1, 1]
    assert predicted.bound[1, 1] <= THIRD_ORDER_FACTOR * compute_angle_spread(scene) ** 3 + 6e-3
    derivative = (predicted.value[2, 1] - predicted.value[0, 1]) / (2 * math.log(1.2))
    assert predicted.by_modulus[1, 1] == pytest.approx(derivative, rel=0.1)


@pytest.mark.slow
def test_a_phase_narrows_the_interval_by_noise_and_contradictions_are_told() -> None:
    scene = lossy()
    true = cmath.phase(complex_ratio(scene, MESH_LEVELS[3]))
    without_phase, with_it = (estimate(scene, read_at(phase, noise=0.05)) for phase in (None, true))
    (low, high), (lower, higher) = with_it.interval_of_noise, without_phase.interval_of_noise
    assert (high or 1e9) / (low or 1e3) < (higher or 1e9) / (lower or 1e3)
    wrong = estimate(scene, read_at(true + 0.2))
    assert wrong.p_value is not None
    assert wrong.p_value < 1e-6


@pytest.mark.slow
def test_loss_factors_known_roughly_take_back_what_phases_tell() -> None:
    scene = lossy()
    true = cmath.phase(complex_ratio(scene, MESH_LEVELS[3]))
    known, rough = (
        estimate(scene, read_at(true, noise=0.05), nuisances=nuisances) for nuisances in ({}, {"tissue.loss_factor": "50 %"})
    )
    assert rough.interval_if_known == pytest.approx(known.interval)
    with pytest.raises(InputError, match="nuisance"):
        estimate(scene, read_at(true), nuisances={"probe.inner.loss_factor": "50 %"})
