"""What all readings have in common: gains, and a tissue that is not known, at several loads; against whole covariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from probe_design.locating.common_errors import CommonErrors
from probe_design.locating.inference import draw_tissues, infer
from probe_design.locating.likelihood import Likelihood
from probe_design.locating.report import build_tables
from probe_design.locating.scan_loads import ScanLoads
from probe_design.populations.design_file import read_design
from tests.probe_design.locating.test_inference import CLEAR, CONDITIONS, GAIN, PLACES, WHITE, likelihood, scan
from tests.support.paths import ROOT
from tests.support.stand_in_model import StandInModel


class StrongerModel(StandInModel):
    """Signals under a load, a third larger."""

    def predict(self, tumours: Floats, positions: Floats) -> Floats:
        return np.asarray(1.3 * super().predict(tumours, positions))


def two_loads() -> tuple[Likelihood, Floats, Floats]:
    """Return a likelihood of readings at two loads and between, the tissue not known, and a and b of LO.5, (q, k, 2)."""
    share = np.tile([0.0, 1.0, 0.4], 9)[: len(PLACES)]
    gains, tissue = CommonErrors.from_channels("ln_gain", np.tile(GAIN, (2, 1))), [[[0.02, 0.15], [-0.03, 0.1]]]
    errors = gains.join(CommonErrors(("tissue",), np.array([0.2]), np.array(tissue), np.array([[[-0.1, -0.12], [-0.2, -0.15]]])))
    weights = np.stack([1 - share, share], axis=1)
    spreads = np.where(share == 0.4, 0.05, 0.0)[:, None] * [-1, 1]
    data = replace(scan(CLEAR, stiffness=True), errors=errors, weights=weights, spreads=spreads)
    subject = replace(likelihood(data, tumours=1), models=(StandInModel(), StrongerModel()))
    return subject, *(np.einsum("kl,qlc->qkc", weights, part) for part in (errors.constant, errors.scale))


def compute_covariance(subject: Likelihood, bodies: Floats, a: Floats, b: Floats) -> tuple[Floats, Floats, Floats]:
    """Return signals (52,), a + b s (q, 52) and the whole covariance of all readings, one channel after the other."""
    weights, spreads = subject.data.weights, subject.data.spreads
    signals = np.stack([model.predict(bodies[None], PLACES)[0] for model in subject.models]) * (np.arange(26) > 0)[:, None]
    signal, doubt = (np.einsum("kl,lkc->kc", part, signals) for part in (weights, spreads))
    rows = (a + b * signal).transpose(0, 2, 1).reshape(len(a), -1)
    return signal.T.ravel(), rows, np.diag(np.repeat(WHITE**2, 26) + doubt.T.ravel() ** 2) + rows.T @ rows


def test_readings_at_several_loads_have_the_whole_covariance() -> None:
    """Against scipy's multivariate normal density over both channels; between loads the signals are interpolated."""
    subject, a, b = two_loads()
    tumours = CLEAR + np.array([[[0.0] * 5], [[1e-3, 0, 1e-3, 0, 0]]])
    values, expected = subject.evaluate_tumours(tumours), []
    for bodies in tumours:
        signal, _, covariance = compute_covariance(subject, bodies, a, b)
        expected.append(multivariate_normal.logpdf(subject.data.values.T.ravel() - signal, cov=covariance))
    assert values[1] - values[0] == pytest.approx(expected[1] - expected[0], abs=1e-6)


def test_gains_and_tissue_are_those_of_the_linear_gaussian_posterior() -> None:
    """Given the tumour, mean and covariance are C_u R C^-1 r and the rest, from the whole covariance C of the readings."""
    subject, a, b = two_loads()
    mean, covariance = (part[0] for part in subject.solve_common(CLEAR))
    signal, rows, whole = compute_covariance(subject, CLEAR[0], a, b)
    gain = rows @ np.linalg.inv(whole)
    assert mean == pytest.approx(gain @ (subject.data.values.T.ravel() - signal), abs=1e-9)
    assert covariance == pytest.approx(np.eye(3) - gain @ rows.T, abs=1e-9)
    common = infer(subject, CONDITIONS, 0, advise=False).nuisances
    assert list(common) == ["ln_gain_ratio", "ln_gain_stiffness", "tissue"]
    assert common["tissue"].before_90 == pytest.approx(5.3e3 * np.exp(0.2 * np.array([-1.645, 1.645])), rel=1e-3)
    # over tumours as well; the tumour is so clear that they add little
    assert np.log(common["tissue"].median / 5.3e3) == pytest.approx(0.2 * mean[2], abs=0.2 * np.sqrt(covariance[2, 2]))
    assert common["tissue"].sd_relative == pytest.approx(np.sqrt(covariance[2, 2]), rel=0.3)
    assert common["ln_gain_stiffness"].is_learnt
    rows_shown = build_tables(infer(subject, CONDITIONS, 0, advise=False))[2].rows
    assert [row[0] for row in rows_shown] == ["ln gain of the ratio", "ln gain of the stiffness", "tissue's Young's modulus, kPa"]


def test_the_contrast_is_to_the_tissue_as_it_is() -> None:
    """Of a tumour whose modulus is known, all that is not known of the contrast is the tissue, over its quantiles."""
    modulus = CLEAR[0, 0, 4]
    subject = replace(two_loads()[0], prior=likelihood(scan(CLEAR), tumours=1, object=modulus).prior)
    location = infer(subject, CONDITIONS, 0, advise=False)
    contrast, tissue = location.tumours[0].quantities["ln_contrast"], location.nuisances["tissue"]
    changes = np.log(np.array(tissue.interval_90) / CONDITIONS.middles["tissue"])
    expected = subject.prior.compute_contrast(CLEAR)[0, 0] - changes[::-1]
    assert contrast.interval_90 == pytest.approx(expected, abs=0.1 * np.ptp(changes))
    assert contrast.sd_relative == pytest.approx(tissue.sd_relative, rel=0.1)


def test_sets_that_cannot_be_predicted_have_no_weight_and_no_tissue() -> None:
    class Shallow(StandInModel):
        def predict(self, tumours: Floats, positions: Floats) -> Floats:
            if np.any(tumours[..., 2] < 5e-3):
                raise Refusal("inclusion", Words("a tumour that takes all of a film's load"), "a smaller or a deeper one")
            return super().predict(tumours, positions)

    subject, tumours = replace(two_loads()[0], models=(Shallow(), StrongerModel())), np.concatenate([CLEAR, CLEAR, CLEAR])
    alone, _ = draw_tissues(subject, CLEAR, np.ones(1))
    tumours[1, 0, 2] = 4e-3
    drawn, deviation = draw_tissues(subject, tumours, np.array([0.5, 0.0, 0.5]))
    assert (drawn[0], drawn[1], deviation) == (pytest.approx(alone[0]), 0.0, 0.2)
    assert drawn[2] != 0


def test_charge_noise_falls_with_the_force() -> None:
    """Of a linear probe the charges are proportional to the force; the white noise is not."""
    known = read_design(ROOT / "examples" / "films.toml")
    noise = known.noise.model_copy(update={"charge": 1e-14, "white": 0.01})
    loads = ScanLoads.from_design(known)
    variances = [loads.compute_noise(noise, force)[0] ** 2 - 0.01**2 for force in (2e-3, 4e-3, None)]
    assert variances[0] == pytest.approx(4 * variances[1])
    assert variances[0] == pytest.approx(25 * variances[2])  # 10 mN, the scene's own
