"""The error of the place of presses by hand: against the normal distribution of all readings and errors together."""

from __future__ import annotations

import numpy as np

from probe_design.locating.common_errors import CommonErrors
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.pose_errors import estimate_pose_errors
from probe_design.locating.prior import TumourPrior
from probe_design.locating.scan_data import ScanData
from probe_design.populations.design_file import design_from_dict
from tests.support.paths import ROOT
from tests.support.stand_in_model import StandInModel

WHITE, GAIN, POSE = 0.003, 0.07, np.array([0.5e-3, 0.8e-3])
LINE = np.linspace(-8e-3, 8e-3, 3)
PLACES = np.array([(30e-3, 0.0), *((x, y) for y in LINE for x in LINE)])  # the baseline reading first
TUMOURS = np.array([[[3.1e-3, -5.4e-3, 9.0e-3, 10e-3, 26e3]], [[2.1e-3, -4.4e-3, 9.5e-3, 10e-3, 26e3]]])
NONE = np.zeros((1, 0, 5))


def build_likelihood() -> Likelihood:
    k = len(PLACES)
    values, variance = np.zeros((k, 2)), np.tile([WHITE**2, np.inf], (k, 1))
    values[:, 0] = 0.03 + WHITE * np.random.default_rng(1).standard_normal(k)
    values[1:, 0] += StandInModel().predict(TUMOURS[:1], PLACES[1:] + POSE * [1, -1])[0, :, 0]
    errors = CommonErrors.from_channels("ln_gain", np.array([GAIN, 0.0]))
    data = ScanData(PLACES, values, variance, np.tile(POSE, (k, 1)), np.arange(k) == 0, errors)
    design = design_from_dict({
        "scene": str(ROOT / "examples" / "scene.toml"),
        "population": {"depth": [8e-3, 20e-3], "diameter": [5e-3, 12e-3], "object": [16e3, 32e3], "x": [-9e-3, 9e-3]},
    })  # fmt: skip
    return Likelihood(data, (StandInModel(),), TumourPrior.from_design(design, PLACES[1:]))


def condition(values: np.ndarray, tumours: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and variance of all pose errors, (k, 2), by the covariance of readings and pose errors."""
    k = len(values)
    residuals, slopes = values[:, 0].copy(), np.zeros((k, 2 * k))
    residuals[1:] -= StandInModel().predict(tumours[None], PLACES[1:])[0, :, 0]
    for row, slope in enumerate(StandInModel().slopes(tumours[None], PLACES[1:])[0, :, 0], start=1):
        slopes[row, 2 * row : 2 * row + 2] = slope
    before = np.diag(np.tile(POSE**2, k))
    covariance = slopes @ before @ slopes.T + GAIN**2 + WHITE**2 * np.eye(k)
    gain = before @ slopes.T @ np.linalg.inv(covariance)
    return (gain @ residuals).reshape(k, 2), np.diag(before - gain @ slopes @ before).reshape(k, 2)


def test_pose_errors_are_those_of_the_joint_normal_distribution() -> None:
    subject = build_likelihood()
    means, variances = zip(*(condition(subject.data.values, bodies) for bodies in TUMOURS), strict=True)
    mean = np.mean(means, axis=0)
    sd = np.sqrt(np.mean(variances, axis=0) + np.var(means, axis=0))
    computed = estimate_pose_errors(subject, (NONE, TUMOURS), np.array([0.0, 1.0]))
    assert computed[0] is None  # of the baseline reading nothing depends on the place
    for pose, expected, spread in zip(computed[1:], mean[1:], sd[1:], strict=True):
        assert pose is not None
        np.testing.assert_allclose((pose.x, pose.y), expected, atol=1e-9)
        np.testing.assert_allclose((pose.x_sd, pose.y_sd), spread, rtol=1e-6)
    assert min(pose.x_sd for pose in computed[1:] if pose) < 0.9 * POSE[0]  # near the tumour something is learnt


def test_without_tumours_nothing_is_learnt_of_the_place() -> None:
    computed = estimate_pose_errors(build_likelihood(), (NONE, TUMOURS), np.array([1.0, 0.0]))
    for pose in computed[1:]:
        assert pose is not None
        np.testing.assert_allclose((pose.x, pose.y, pose.x_sd, pose.y_sd), (0, 0, *POSE), atol=1e-12)
