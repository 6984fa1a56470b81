"""Markov chains follow where rounds of importance sampling fall short, and leave the evidence without bias."""

from __future__ import annotations

import math

import numpy as np
import pytest

from probe_design.locating import several
from probe_design.locating.sampling import draw_posteriors
from tests.probe_design.locating.test_inference import APART, CLEAR, likelihood, scan


@pytest.mark.slow
def test_evidence_by_markov_chains_is_the_mean_likelihood_of_the_prior(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against plain Monte Carlo over the prior, in a scan weak enough for it."""
    for name, value in {"MIN_SIZE": math.inf, "MAX_ROUNDS": 1, "MAX_CHAIN_RUNS": 1, "CHAINS": 500, "CHAIN_SIZE": 2048}.items():
        monkeypatch.setattr(several, name, value)
    subject = likelihood(scan(CLEAR + np.array([0, 0, 6e-3, -2e-3, 0]), seed=3))
    sample = draw_posteriors(subject, 2, 0)[-1]
    assert len(sample.points) == 2 * 2048  # those of the chains' mixtures
    points = np.random.default_rng(8).random((60_000, 2, 5))
    values = np.concatenate([subject.evaluate(part) for part in np.array_split(points, 15)])
    allowed = values[np.isfinite(values)]
    plain = allowed.max() + np.log(np.mean(np.exp(allowed - allowed.max())))
    assert sample.log_evidence == pytest.approx(plain, abs=0.15)


def test_a_scan_whose_rounds_converge_runs_no_markov_chains(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(several, "CHAINS", None)  # which no chain could start with
    assert draw_posteriors(likelihood(scan(CLEAR)), 3, 0)[-1].is_converged


@pytest.mark.slow
def test_markov_chains_mend_the_evidence_of_three_tumours(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two clear ones, whose rounds alone differ by 0.35 between repeats."""
    subject = likelihood(scan(APART, stiffness=True))
    mended = draw_posteriors(subject, 3, 0)[-1]
    monkeypatch.setattr(several, "MAX_CHAIN_RUNS", 0)
    rounds = draw_posteriors(subject, 3, 0)[-1]
    assert rounds.repeat_difference > several.MAX_DIFFERENCE > mended.repeat_difference
    assert mended.size > 3 * rounds.size
