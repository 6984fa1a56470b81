"""Numbers of the scene that are known only roughly: what they cost, and what a reading beside the tumour gives back."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize
from scipy.stats import binomtest

from geometry import Scene, read_scene
from geometry.common.errors import InputError
from geometry.scenes.scene_tables import Load
from geometry.scenes.variables import list_values
from probe_design.estimation.estimate import estimate, search_unknown
from probe_design.estimation.estimate_result import Estimate
from probe_design.estimation.intervals import CHI2_QUANTILE, Likelihood
from probe_design.estimation.measurements import Measurements, Reading, read_readings
from probe_design.estimation.model import TargetModel
from probe_design.estimation.nuisances import SharedErrors, check_nuisances, compute_nuisance_errors
from probe_design.estimation.profile import Track, compute_coordinate
from solver import evaluate
from tests.support.paths import SCENE
from tests.support.program import refused, run

NOISE = 0.01
TISSUE, BLOCK = "tissue.youngs_modulus", "probe.outer.youngs_modulus"


def scene(**new: float) -> Scene:
    return read_scene(SCENE).replace({"inclusion.depth": 7e-3, "inclusion.youngs_modulus": 20e3} | new)


def read(scene_read: Scene, *, blank: bool) -> float:
    """Readings as an independent evaluator predicts them."""
    return evaluate(scene_read.model_copy(update={"inclusion": ()}) if blank else scene_read, "axisymmetric", 1e-3).ratio or 0.0


def width(estimated: Estimate) -> float:
    low, high = estimated.interval
    assert low is not None
    assert high is not None
    return float(np.log(high / low))


def test_shared_errors_are_those_of_the_covariance() -> None:
    chance = np.random.default_rng(0)
    v, A = chance.normal(size=(5, 4)), chance.normal(size=(5, 4, 2))
    wanted = np.array([np.linalg.solve(np.eye(4) + a @ a.T, vector) for vector, a in zip(v, A, strict=True)])
    errors = SharedErrors.from_linear(A)
    assert errors.decorrelate(v) == pytest.approx(wanted, rel=1e-12)
    assert errors.compute_misfit(v) == pytest.approx((v * wanted).sum(axis=1), rel=1e-12)


def test_the_misfit_is_the_least_over_what_is_not_known() -> None:
    """Scipy's own minimisation finds none better."""
    chance = np.random.default_rng(1)
    residual, line, bend = 2 * chance.normal(size=4), chance.normal(size=(4, 2)), 0.1 * chance.normal(size=(4, 2))
    misfit = minimize(
        lambda eta: ((residual - line @ eta - bend @ eta**2) ** 2).sum() + (eta**2).sum(), np.zeros(2), tol=1e-14
    ).fun
    assert SharedErrors(np.hstack([line, bend]), np.vstack([np.eye(2, dtype=int), 2 * np.eye(2, dtype=int)])).compute_misfit(
        residual
    ) == pytest.approx(misfit, rel=1e-6)


@pytest.mark.slow
def test_a_modulus_known_to_20_percent_costs_and_a_blank_gives_most_of_it_back() -> None:
    """The truth has another outer block than the scene states: without that nuisance the interval misses it."""
    truth = scene(**{BLOCK: 80e3 * 1.25})
    plain, with_blank = (read(truth, blank=blank) for blank in (False, True))
    reading, blank = Reading(0.0, 0.0, plain, NOISE), Reading(0.0, 0.0, with_blank, NOISE, blank=True)
    blind = estimate(scene(), (reading,))
    rough = estimate(scene(), (reading,), nuisances={BLOCK: 0.2})
    helped = estimate(scene(), (reading, blank), nuisances={BLOCK: "20 %"})
    assert blind.interval[1] is not None
    assert not (blind.interval[0] or 0.0) < 20e3 < blind.interval[1]
    assert rough.interval_if_known == blind.interval
    for estimated in (rough, helped):
        low, high = estimated.interval
        assert (low or 0.0) < 20e3 < (high or np.inf)
    assert rough.interval[1] is None or width(rough) > 1.5 * width(helped)
    assert helped.nuisances == {BLOCK: 0.2}


@pytest.mark.slow
def test_coverage() -> None:
    """Of scenes whose outer block is drawn from its prior, as the evaluator itself reads them with noise, at next to no load."""
    soft_scene, sd, modulus = scene().model_copy(update={"load": Load(force=1e-4)}), 0.15, 20e3
    reading = Reading(0.0, 0.0, 1.0, NOISE, 100.0, NOISE)
    data = Measurements.from_readings((reading, Reading(0.0, 0.0, 1.0, NOISE, blank=True)))
    model = TargetModel(soft_scene, data, NOISE / 4)
    fit = Likelihood(Track.from_model(model, "youngs_modulus").add_nuisances({BLOCK: sd}), data.noise)
    nodes = np.linspace(-4 * sd, 4 * sd, 9)
    exact = CubicSpline(
        nodes,
        [model.replace_values({BLOCK: list_values(soft_scene)[BLOCK] * float(np.exp(t))}).predict({}).value[0] for t in nodes],
    )
    chance = np.random.default_rng(3)
    y = exact(np.clip(chance.normal(0, sd, 3000), nodes[0], nodes[-1])) + NOISE * chance.normal(size=(3000, len(data.value)))
    u = np.full(len(y), compute_coordinate(model, "youngs_modulus", np.array([modulus]))[0])
    covered = fit.compute_chi_square(u, y) - fit.find_best(y)[1] <= fit.interpolate_limit(u)
    assert binomtest(int(covered.sum()), len(y), 0.95).pvalue > 0.001
    blind = Likelihood(Track.from_model(model, "youngs_modulus"), data.noise)
    assert (blind.compute_chi_square(u, y) - blind.find_best(y)[1] <= CHI2_QUANTILE).mean() < 0.8  # what it is for


@pytest.mark.slow
def test_a_number_of_the_tissue_may_be_the_unknown_without_any_tumour() -> None:
    bare = read_scene(SCENE).model_copy(update={"inclusion": ()})
    stiffness = evaluate(bare.replace({TISSUE: 9e3}), "axisymmetric", 1e-3).stiffness
    ratio = read(bare.replace({TISSUE: 9e3}), blank=True)
    estimated = estimate(bare, (Reading(0.0, 0.0, ratio, NOISE, stiffness, NOISE),), TISSUE)
    assert estimated.value == pytest.approx(9e3, rel=0.01)
    assert estimated.interval[0] is not None
    assert estimated.interval[0] < 9e3 < (estimated.interval[1] or 0.0)
    assert estimated.depth is estimated.strength is None


@pytest.mark.slow
def test_several_places_share_the_error_too() -> None:
    readings = tuple(Reading(x, 0.0, 0.6, NOISE) for x in (-6e-3, 0.0, 6e-3))
    model = TargetModel(scene(), Measurements.from_readings(readings), 0.01)
    certain, rough = (search_unknown(model, "youngs_modulus", known) for known in ({}, {TISSUE: 0.3}))
    assert rough.p_value > certain.p_value  # what a common shift explains is no contradiction
    assert rough.pieces_if_known == certain.pieces


def test_readings_files_have_blanks(tmp_path: Path) -> None:
    table, toml = tmp_path / "scan.csv", tmp_path / "scan.toml"
    table.write_text("ratio, noise, blank\n0.6, 0.02,\n0.5, 0.02, TRUE\n0.5, 0.02, false\n")
    toml.write_text("[[reading]]\nratio = 0.6\nnoise = 0.02\n[[reading]]\nratio = 0.5\nnoise = 0.02\nblank = true\n")
    assert [reading.blank for reading in read_readings(table, scene())] == [False, True, False]
    assert [reading.blank for reading in read_readings(toml, scene())] == [False, True]
    toml.write_text("[[reading]]\nratio = 0.6\nnoise = 0.02\nblank = 1\n")
    with pytest.raises(InputError, match="true or false"):
        read_readings(toml, scene())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--nuisance", "probe.gap"), ("nuisance", "probe.gap = 20 %")),
        (("--nuisance", "probe.gape = 0.2"), ("nuisance", "probe.gap")),
        (("--nuisance", "probe.gap = 0"), ("nuisance.probe.gap", "above 0")),
        (("--nuisance", "probe.gap = 200 %"), ("nuisance.probe.gap", "above 0")),
        (("--nuisance", "probe.gap = x %"), ("nuisance.probe.gap",)),
        (("--nuisance", "inclusion.youngs_modulus = 0.2"), ("nuisance",)),
        (("--nuisance", "inclusion.depth = 0.9"), ("nuisance.inclusion.depth",)),
        (("--unknown", "tissue.layer[0].thickness"), ("unknown", "tissue.youngs_modulus")),
        (("--unknown", "tissue.depth"), ("unknown", "tissue.youngs_modulus")),
    ],
)
def test_refusals(arguments: tuple[str, ...], words: tuple[str, ...]) -> None:
    line = refused("estimate", SCENE, "--ratio", "0.6", *arguments)
    for word in words:
        assert word in line


def test_blanks_alone_say_nothing_of_a_tumour() -> None:
    with pytest.raises(InputError, match=r"reading\.blank"):
        estimate(scene(), (Reading(0.0, 0.0, 0.6, NOISE, blank=True),))


def test_command_line() -> None:
    ended = run("estimate", SCENE, "--ratio", "0.57", "--noise", "0.02", "--nuisance", f"{TISSUE} = 10 %")
    assert ended.returncode == 0, ended.stderr
    assert f"{TISSUE} known to 10 %" in " ".join(ended.stdout.split())
    ended = run("estimate", SCENE, "--ratio", "0.57", "--noise", "0.02", "--nuisance", f"{TISSUE} = 10 %", "--json")
    assert json.loads(ended.stdout)["nuisances"] == {TISSUE: 0.1}


@dataclass(frozen=True)
class Turning:
    """A model whose ratio turns its sign where the tissue is more than a tenth stiffer than the scene says."""

    scene: Scene
    stiffer: float = 1.0

    def replace_values(self, new: dict[str, float]) -> Turning:
        return Turning(self.scene, new[TISSUE] / list_values(self.scene)[TISSUE])

    def predict(self, target: dict[str, np.ndarray]) -> SimpleNamespace:
        ones = np.ones(len(target["youngs_modulus"]))
        return SimpleNamespace(value=np.log(self.stiffer) * ones[:, None], resolved=ones > 0, agrees=self.stiffer * ones < 1.1)


def test_a_number_that_turns_the_ratios_sign_is_refused() -> None:
    """On either side of zero logarithms are of ratios of either sign: no line goes through them."""
    model: Any = Turning(scene())
    target = {"youngs_modulus": np.array([1e3, 1e4])}
    assert compute_nuisance_errors(model, {TISSUE: 0.05}, np.zeros(2), target).errors.linear.ravel() == pytest.approx(0.05)
    with pytest.raises(InputError, match=rf"nuisance.{TISSUE} = 0.2: allowed: a smaller one: the model cannot predict"):
        compute_nuisance_errors(model, {TISSUE: 0.2}, np.zeros(2), target)


def test_a_constant_of_a_law_is_a_nuisance_by_its_path() -> None:
    plain = read_scene(SCENE)
    stiffening = plain.replace({"tissue.law": "yeoh", "tissue.c2_over_c1": 0.5})
    assert check_nuisances(stiffening, {"tissue.c2_over_c1": "20 %"}, "youngs_modulus") == {"tissue.c2_over_c1": 0.2}
    for other, name in ((plain, "tissue.c2_over_c1"), (stiffening, "tissue.c3_over_c1")):  # 0 has no relative uncertainty
        with pytest.raises(InputError, match=rf"nuisance = '{name}'"):
            check_nuisances(other, {name: 0.2}, "youngs_modulus")
