"""Covariances of readings against simulated ones and against what cancels."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.common.errors import InputError
from geometry.scenes.scene_tables import Load
from probe_design.populations.noise import build_difference_noise, build_full_noise
from probe_design.populations.tables import NoiseModel, Protocol
from tests.probe_design.populations.test_detection import simulated
from tests.support.designs import THREE, example_design

BLANK = np.array([3.0, 1.0])
QUIET = NoiseModel(charge=0.0, white=0.02, gain=0.05, stiffness_white=0.01, stiffness_gain=0.03)


@pytest.mark.parametrize("blank", [True, False])
def test_covariance_is_that_of_simulated_readings(blank: bool) -> None:
    protocol = example_design(protocol={**THREE, "blank": blank}).protocol
    C = build_difference_noise(QUIET, protocol, example_design().scene, BLANK).covariance
    errors = simulated(QUIET, protocol, 200_000, 0)
    assert np.abs(np.cov(errors.T) - C).max() < 0.02 * C.max()


def test_a_gain_common_to_the_scan_cancels_with_a_blank() -> None:
    protocol, scene = Protocol(blank=True), example_design().scene
    louder = QUIET.model_copy(update={"gain": 1.0, "stiffness_gain": 2.0})
    assert np.array_equal(*(build_difference_noise(noise, protocol, scene, BLANK).covariance for noise in (QUIET, louder)))
    without_blank = Protocol(blank=False)
    assert not np.allclose(*(build_difference_noise(noise, without_blank, scene, BLANK).covariance for noise in (QUIET, louder)))


def test_a_blank_doubles_white_noise_and_is_shared() -> None:
    C = build_difference_noise(QUIET, Protocol(blank=True, stiffness=False), example_design().scene, BLANK).covariance
    assert np.diag(C) == pytest.approx(2 * QUIET.white**2)
    assert C[0, 1] == pytest.approx(QUIET.white**2)


def test_charge_noise_is_that_of_the_films_forces() -> None:
    scene = example_design().scene
    noise = NoiseModel(white=0.0, charge=1e-14)
    C = build_difference_noise(noise, Protocol(blank=False, stiffness=False, positions=(0.0,)), scene, BLANK).covariance
    forces = 0.01 * np.array([0.75, 0.25])  # N, of the load of 10 mN
    assert C[0, 0] - 2 * noise.gain**2 == pytest.approx(((1e-14 / (20e-12 * forces)) ** 2).sum())


def test_tissue_counts_without_a_blank_alone() -> None:
    scene, shift = example_design().scene, np.ones((18, 1))
    for blank in (True, False):
        plain, gained = (
            build_difference_noise(QUIET, Protocol(blank=blank, stiffness=True), scene, BLANK, tissue=tissue).covariance
            for tissue in (None, shift)
        )
        assert np.allclose(gained - plain, 0.0 if blank else 1.0)


@pytest.mark.parametrize(
    ("noise", "load", "key"),
    [
        (NoiseModel(white=0.0, charge=0.0), Load(force=0.01), "noise.white"),
        (NoiseModel(stiffness_white=0.0), Load(force=0.01), "noise.stiffness_white"),
        (NoiseModel(), Load(force=0.0), "load.force"),
        (NoiseModel(), Load(indentation=0.0), "load.indentation"),
    ],
)
def test_readings_without_noise_or_charge_are_refused(noise: NoiseModel, load: Load, key: str) -> None:
    scene = example_design().scene.model_copy(update={"load": load})
    with pytest.raises(InputError) as fault:
        build_difference_noise(noise, Protocol(stiffness=True), scene, BLANK)
    assert fault.value.key == key


def test_all_readings_taken_from_the_blank_are_the_differences() -> None:
    """Eq. PO.2 from eq. PO.8: each reading less the blank's of its channel, whatever the gains."""
    protocol, scene = Protocol(stiffness=True), example_design().scene
    readings_over = np.tile(BLANK, (9, 1)) * np.linspace(0.9, 1.1, 18).reshape(9, 2)
    noise = QUIET.model_copy(update={"charge": 1e-14})
    difference = np.hstack([np.eye(18), -np.kron(np.eye(2), np.ones((9, 1)))])
    whole = difference @ build_full_noise(noise, protocol, scene, BLANK, readings_over).covariance @ difference.T
    assert whole == pytest.approx(
        build_difference_noise(noise, protocol, scene, BLANK, tumour_forces=readings_over).covariance, rel=1e-12, abs=1e-15
    )
