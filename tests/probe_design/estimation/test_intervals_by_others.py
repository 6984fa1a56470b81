"""Intervals against what other evaluators read, and their parts against closed forms."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest, norm

from benchmarks.readings.cases import cases
from benchmarks.readings.intervals import outcome
from benchmarks.readings.truths import ReadingTruth
from geometry import Scene, read_scene
from geometry.scenes.variables import list_values
from probe_design.estimation.intervals import compute_threshold_near_ends
from probe_design.estimation.nuisances import compute_nuisance_errors
from tests.support.paths import SCENE

TISSUE, BLOCK = "tissue.youngs_modulus", "probe.outer.youngs_modulus"


@pytest.mark.parametrize("name", ["modulus, 1 %", "modulus, 5 %"])
def test_intervals_cover_what_the_axisymmetric_evaluator_reads(name: str) -> None:
    (case,) = (candidate for candidate in cases() if candidate.name == name)
    coverage = outcome(ReadingTruth.from_case(case), 1000, seed=3)
    assert coverage.p_value > 0.001


def test_quantile_at_an_end_is_one_sided() -> None:
    """Half of all noise lies beyond the end, where the best fit is the end itself."""
    q = compute_threshold_near_ends(np.zeros(2), np.array([0.0, np.inf]), np.array([np.inf, np.inf]))
    assert q == pytest.approx([norm.ppf(0.95) ** 2, norm.ppf(0.975) ** 2], rel=1e-6)


@pytest.mark.parametrize(("below", "above"), [(0.0, 0.3), (0.5, 0.5), (1.0, 3.0), (0.0, 9.0)])
def test_quantile_on_a_short_line(below: float, above: float) -> None:
    """Drawn noise, the best fit on the line found by clipping."""
    z = np.random.default_rng(4).normal(size=20_000)
    excess = z**2 - (z - np.clip(z, -below, above)) ** 2
    q = compute_threshold_near_ends(np.zeros(1), np.array([below]), np.array([above]))
    assert binomtest(int((excess <= q).sum()), len(z), 0.95).pvalue > 0.001


@dataclass(frozen=True)
class Bent:
    """A model in closed form whose two numbers act on each other: ln(1 + a b) of their shares of the scene's."""

    scene: Scene
    a: float = 1.0
    b: float = 1.0

    def replace_values(self, new: dict[str, float]) -> Bent:
        scene_values = list_values(self.scene)
        return Bent(self.scene, *(new.get(key, scene_values[key]) / scene_values[key] for key in (TISSUE, BLOCK)))

    def predict(self, target: dict[str, np.ndarray]) -> SimpleNamespace:
        ones = np.ones((len(target["youngs_modulus"]), 1))
        return SimpleNamespace(value=np.log(1 + self.a**2 * self.b) * ones, resolved=ones[:, 0] > 0, agrees=ones[:, 0] > 0)


@pytest.mark.parametrize("eta", [(2.0, -2.0), (2.0, 2.0), (-1.0, 2.0), (2.5, 0.0), (-2.0, -1.0)])
def test_numbers_known_roughly_act_together(eta: tuple[float, float]) -> None:
    model: Any = Bent(read_scene(SCENE))
    deviations = compute_nuisance_errors(model, {TISSUE: 0.3, BLOCK: 0.3}, np.zeros(1), {"youngs_modulus": np.array([1e4])})
    exact = np.log(1 + np.exp(0.6 * eta[0] + 0.3 * eta[1])) - np.log(2)
    assert deviations.errors.evaluate(np.array(eta))[0, 0] == pytest.approx(
        exact, abs=0.03
    )  # without products of both: up to 0.18 off
