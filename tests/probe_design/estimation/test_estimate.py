"""Estimates: coverage of the intervals, an independent model, what cannot be determined, and `probe-design estimate` itself."""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binomtest, norm

from geometry import Load, Scene, read_scene
from geometry.common.errors import InputError, Refusal
from geometry.scenes.scene_file import scene_from_dict, scene_to_toml
from probe_design.estimation.depth_and_strength import Plane
from probe_design.estimation.estimate import estimate, search_unknown
from probe_design.estimation.estimate_result import Estimate
from probe_design.estimation.intervals import CHI2_QUANTILE, Likelihood, compute_threshold
from probe_design.estimation.measurements import Measurements, Reading, build_single_reading, read_readings
from probe_design.estimation.model import TargetModel
from probe_design.estimation.profile import Track, compute_coordinate
from solver import evaluate
from tests.support.load_paths import added_by_blocks
from tests.support.paths import EXAMPLES, REFERENCE
from tests.support.program import refused, run
from tests.support.slow import slow_unless

SIMULATIONS = 2000
SCAN = tuple(np.linspace(-12e-3, 12e-3, 7).tolist())


LIGHT = Load(force=1e-3)  # N: finite strain is nothing beside the least noise


def scene(depth: str = "9 mm", modulus: str = "60 kPa", nu: float = 0.48, diameter: str = "8 mm", **probe: object) -> Scene:
    """The probe and tumour of PHYSICS section 2, which gives neither Poisson's ratios nor the tissue's size."""
    blocks = {key: {"youngs_modulus": E, "poisson_ratio": 0.48} for key, E in (("inner", "1.13 MPa"), ("outer", "0.785 MPa"))}
    probe_table = {"inner_radius": "2.51 mm", "area_ratio": 0.117, "gap": "0.22 mm", "height": "2.47 mm", "base": {"rigid": True}}
    return scene_from_dict(
        {
            "probe": probe_table | blocks | probe,
            "tissue": {"shape": "cylinder", "radius": "60 mm", "depth": "60 mm", "youngs_modulus": "6 kPa", "poisson_ratio": nu},
            "inclusion": [{"diameter": diameter, "depth": depth, "youngs_modulus": modulus, "poisson_ratio": nu}],
            "load": {"force": "0.03 N"},
        }
    )


def value_of(scene: Scene, unknown: str) -> float:
    return float(getattr(scene.inclusion[0], unknown))


def model(scene: Scene, noise: float, places: tuple[float, ...] = (0.0,), stiffness: bool = False) -> TargetModel:
    readings = tuple(Reading(x, 0.0, 1.0, noise, 100.0 if stiffness else None, noise) for x in places)
    return TargetModel(scene, Measurements.from_readings(readings), 0.01)


@cache
def exact_ratio(scene: Scene) -> float:
    return evaluate(scene, "axisymmetric", 1e-3).ratio or 0.0


@cache
def track(scene: Scene, unknown: str, places: tuple[float, ...], stiffness: bool) -> Track:
    return Track.from_model(model(scene, 0.05, places, stiffness), unknown).remove_model_error()


@pytest.mark.parametrize(
    ("truth", "unknown", "noise", "places", "stiffness"),
    [
        (scene(modulus="20 kPa"), "youngs_modulus", 0.01, (0.0,), False),  # identifiable
        (scene(), "youngs_modulus", 0.05, (0.0,), False),  # mostly open above
        (scene(modulus="6 MPa"), "youngs_modulus", 0.05, (0.0,), True),  # saturated: hardly anything is told
        (scene(), "diameter", 0.05, (0.0,), False),
        (scene(), "depth", 0.05, (0.0,), True),
        pytest.param(scene(modulus="20 kPa"), "youngs_modulus", 0.02, (-8e-3, 0.0, 8e-3), True, marks=pytest.mark.slow),
        pytest.param(scene(modulus="6 MPa"), "youngs_modulus", 0.05, (-8e-3, 0.0, 8e-3), False, marks=pytest.mark.slow),
        pytest.param(scene(depth="15 mm"), "depth", 0.03, (-8e-3, 0.0, 8e-3), False, marks=pytest.mark.slow),
    ],
)
def test_coverage(truth: Scene, unknown: str, noise: float, places: tuple[float, ...], stiffness: bool) -> None:
    tracked = track(truth, unknown, places, stiffness)
    fit = Likelihood(tracked, np.full(len(tracked.model.data.value), noise))
    coordinates = compute_coordinate(tracked.model, unknown, np.array([value_of(truth, unknown)]))
    mean = tracked.model.predict({unknown: tracked.compute_values(coordinates)}).value
    y = mean + noise * np.random.default_rng(7).normal(size=(SIMULATIONS, mean.shape[1]))
    covered = fit.find_unexplained(y) | (
        fit.compute_chi_square(coordinates, y) - fit.find_best(y)[1] <= fit.interpolate_limit(coordinates)
    )  # no interval is an open one
    assert binomtest(int(covered.sum()), SIMULATIONS, 0.95).pvalue > 0.001
    value = value_of(truth, unknown)
    for reading, yes in zip(y[:30], covered, strict=False):  # the intervals are the set of values that the test does not reject
        pieces = fit.find_pieces(reading)
        assert yes == (not pieces or any(piece.low <= value <= piece.high for piece in pieces))


def test_an_error_within_its_bound_costs_no_more_coverage_than_stated() -> None:
    for shift in (0.0, 0.2, 1 / 3, 0.34, 1.0, 3.9, 4.1, 30.0):
        c = np.sqrt(compute_threshold(np.array(shift)))
        worst = norm.cdf(c - shift) - norm.cdf(-c - shift)
        assert worst > 0.936
        assert shift < 0.34 or worst == pytest.approx(0.95, abs=1e-4)


@pytest.mark.parametrize("partner", ["youngs_modulus", "diameter"])
def test_coverage_of_depth_and_strength_together(partner: str) -> None:
    truth, noise = scene(depth="11 mm", modulus="20 kPa"), 0.01
    plane = Plane.from_model(model(truth, noise, SCAN), partner)
    centre = (
        np.log(value_of(truth, "depth")),
        np.log(20e3 if partner == "youngs_modulus" else 8e-3 / plane.model.compute_max_diameter(11e-3)),
    )
    u, v = (np.unique(np.append(interval_value + np.linspace(*ends, 141), interval_value)) for interval_value, ends in
            zip(centre, ((-0.6, 0.6), (-2.0, 5.0) if partner == "youngs_modulus" else (-0.9, 0.9)), strict=True))  # fmt: skip
    v = v[v <= plane.v[-1]]
    value, dark = plane.interpolate(u, v)
    value = np.where(dark[..., None], 1e9, value)
    mean = plane.model.predict({partner: np.array([value_of(truth, partner)])}, reflect=False).value[0]
    assert plane.interpolate(*(np.array([interval_value]) for interval_value in centre))[0][0, 0] == pytest.approx(mean, abs=1e-4)
    S, wanted = plane.compute_strengths(u, v), float(model(truth, 0.05).compute_strength())
    close = np.abs(S / wanted - 1) < 0.02
    hits = np.zeros((1000, 2), dtype=bool)
    for hit, y in zip(hits, mean + noise * np.random.default_rng(5).normal(size=(1000, len(mean))), strict=True):
        chi2 = (((y - value) / noise) ** 2).sum(axis=-1)
        hit[:] = np.array([chi2[np.argmin(np.abs(u - centre[0]))].min(), chi2[close].min()]) - chi2.min() <= CHI2_QUANTILE
    assert np.all((hits.mean(axis=0) > 0.92) & (hits.mean(axis=0) < 0.975))


TRUTHS = [scene(), scene(modulus="15 kPa", nu=0.45), scene(depth="14 mm", modulus="2 kPa", nu=0.4)]


@pytest.mark.parametrize("noise", slow_unless((0.05).__eq__, [0.05, 0.01]))
@pytest.mark.parametrize("truth", slow_unless(TRUTHS[2].__eq__, TRUTHS))
@pytest.mark.parametrize("unknown", ["youngs_modulus", "diameter", "depth"])
def test_an_independent_model_is_read_right(truth: Scene, noise: float, unknown: str) -> None:
    """``axisymmetric`` reads 1.5 standard deviations too much or too little: the truth is inside."""
    real = exact_ratio(truth)
    for distance in (-1.5, 0.0, 1.5):
        estimated = estimate(truth, build_single_reading(truth, real * np.exp(distance * noise), noise), unknown)
        low, high = estimated.interval
        assert (low or 0.0) <= value_of(truth, unknown) <= (high or np.inf)
        assert estimated.strength is not None
        assert estimated.error_estimate is not None


@pytest.mark.slow
def test_numbers_of_physics_section_2() -> None:
    """Those of the optimised probe: derivatives, and the standard deviation of ln E_object at 5 %, 1 % and 0.2 % noise."""
    truth = scene().model_copy(update={"load": LIGHT})
    ratio = exact_ratio(truth)
    target_model = model(truth, 0.05)
    derivatives = {unknown: Track.from_model(target_model, unknown) for unknown in ("diameter", "depth")}
    coordinates = {key: compute_coordinate(target_model, key, np.array([value_of(truth, key)])) for key in derivatives}
    assert derivatives["depth"].interpolate(coordinates["depth"])[1][0, 0] == pytest.approx(-0.75, rel=0.05)
    assert derivatives["diameter"].interpolate(coordinates["diameter"])[1][0, 0] * coordinates["diameter"][0] == pytest.approx(
        0.72, rel=0.05
    )
    sensitivity = target_model.predict({"youngs_modulus": np.array([60e3])}).by_modulus[0, 0]
    assert 0.05 / sensitivity == pytest.approx(0.81, rel=0.05)
    for noise, deviation in ((0.01, 0.16), (0.002, 0.032)):
        low, high = estimate(truth, build_single_reading(truth, ratio, noise)).interval_of_noise
        assert low is not None
        assert high is not None
        assert np.log(high / low) / (2 * 1.96) == pytest.approx(deviation, rel=0.15)
    wide = estimate(truth, build_single_reading(truth, ratio, 0.05))
    assert not wide.identifiable
    assert wide.interval[1] is None


def test_what_cannot_be_told_is_said_plainly() -> None:
    truth = scene()
    open_above = estimate(truth, build_single_reading(truth, 0.71, 0.05))
    assert (open_above.value, open_above.identifiable, open_above.interval[1]) == (None, False, None)
    assert "stiff" in str(open_above.reason)
    assert open_above.depth == pytest.approx(9e-3)
    assert open_above.depth_interval is None
    low, high = open_above.strength_interval or (None, None)
    assert low is not None
    assert high == pytest.approx(float(model(truth, 0.05).compute_strength(modulus=np.inf)), rel=1e-4)
    upper = estimate(truth, build_single_reading(truth, 2.0, 0.01))
    assert upper.interval == (None, None)
    assert "above" in str(upper.reason)
    assert any("contradict" in warning for warning in upper.warnings)
    noisy = estimate(truth, build_single_reading(truth, 0.7, 2.0))
    assert "any E_object" in str(noisy.reason)
    negative = estimate(truth, (Reading(0.0, 0.0, -0.7, 0.05),))
    assert "sign" in str(negative.reason)


@pytest.mark.slow
def test_a_scan_tells_depth_and_strength() -> None:
    truth = scene().model_copy(update={"load": LIGHT})
    places = SCAN[1:-1]
    target_model = model(truth, 0.01, places)
    mean = target_model.predict({"youngs_modulus": np.array([60e3])}, reflect=True).value[0]
    y = np.exp(mean + 0.01 * np.random.default_rng(2).normal(size=len(mean)))
    estimated = estimate(truth, tuple(Reading(x, 0.0, float(r), 0.01) for x, r in zip(places, y, strict=True)))
    assert estimated.identifiable
    for value, interval in (
        (9e-3, estimated.depth_interval),
        (float(model(truth, 0.05).compute_strength()), estimated.strength_interval),
    ):
        low, high = interval or (None, None)
        assert low is not None
        assert high is not None
        assert low < value < high < 2.5 * low
    deep = scene(depth="25 mm")
    odd = estimate(deep, tuple(Reading(x, 0.0, ratio, 0.01) for x, ratio in zip(places, (1.0, 0.5, 0.5, 0.5, 0.5), strict=True)))
    assert any("contradict" in warning for warning in odd.warnings)


def test_a_track_is_the_model_between_its_nodes() -> None:
    for unknown in ("youngs_modulus", "diameter", "depth"):
        tracked = track(scene(), unknown, (0.0,), False)
        x = (tracked.x[1:-1] + tracked.x[2:])[:-1] / 2
        real = tracked.model.predict({unknown: tracked.compute_values(x)})
        assert np.abs(tracked.interpolate(x)[0] - real.value).max() < 1e-3
        assert compute_coordinate(tracked.model, unknown, tracked.compute_values(x)) == pytest.approx(x, rel=1e-9)


def test_useless_stiffness_is_left_out_and_scenes_of_two_tumours_work() -> None:
    truth = scene()
    two = truth.model_copy(update={"inclusion": (
        truth.inclusion[0].model_copy(update={"target": True}), truth.inclusion[0].model_copy(update={"x": 25e-3}))})  # fmt: skip
    single, pair = (estimate(scene_read, (Reading(0.0, 0.0, 0.7, 0.01, 120.0, 1e-6),)) for scene_read in (truth, two))
    assert any("left out" in warning for warning in single.warnings)
    assert single.value == pytest.approx(pair.value, rel=0.05)


def test_readings_files(tmp_path: Path) -> None:
    truth = scene()
    table, toml = tmp_path / "scan.csv", tmp_path / "scan.toml"
    table.write_text("x, ratio, noise, stiffness\n-8 mm, 0.55, 0.02, 79 N/m\n\n0 mm, 0.62,,\n")
    toml.write_text('[[reading]]\nx = "-8 mm"\nratio = 0.55\nnoise = 0.02\nstiffness = 79\n[[reading]]\nratio = 0.62\n')
    wanted = (Reading(-8e-3, 0.0, 0.55, 0.02, 79.0, 0.02), Reading(0.0, 0.0, 0.62, 0.05, None, 0.05))
    assert read_readings(table, truth, 0.05) == read_readings(toml, truth, 0.05) == wanted


@pytest.mark.parametrize(
    "text",
    [
        "X;Ratio;Noise;Stiffness\r\n-8,0 mm;0,55;0,02;79,0 N/m\r\n;;;\r\n0 mm;0,62;;\r\n",
        "\ufeffx\tratio\tnoise\tstiffness\n-8 mm\t0.55\t0.02\t79 N/m\n0 mm\t0,62\t\t\n",
        "x,ratio,noise,stiffness,,\n-8 mm,0.55,0.02,79 N/m,,\n0 mm,0.62,,,,\n,,,,,\n",
    ],
)
def test_files_of_spreadsheets_are_read(tmp_path: Path, text: str) -> None:
    """With semicolons x was "missing": decimal commas, tabs, large letters, a byte-order mark, empty rows and columns."""
    (tmp_path / "scan.csv").write_bytes(text.encode())
    wanted = (Reading(-8e-3, 0.0, 0.55, 0.02, 79.0, 0.02), Reading(0.0, 0.0, 0.62, 0.05, None, 0.05))
    assert read_readings(tmp_path / "scan.csv", scene(), 0.05) == wanted


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("scan.txt", "", (".toml or .csv",)),
        ("scan.csv", "x,ratio\n90 mm,0.5\n", ("reading[0].x", "90 mm", "less than")),
        ("scan.csv", "x,ratio\n0 mm,0\n", ("reading[0].ratio", "above 0")),
        ("scan.csv", "x,ratio\n0 mm,-1\n", ("reading[0].ratio", "'-1'", "above 0")),
        ("scan.csv", "x,ratio\n0,0.5\n", ("reading[0].x", "unit is missing")),
        ("scan.csv", "x,ratio,noise\n0 mm,0.5,-1\n", ("reading[0].noise", "1e-06")),
        ("scan.csv", "x,ratio\n0 mm\n", ("reading[0]", "cells")),
        ("scan.csv", "x,colour\n0 mm,red\n", ("column 'colour'", "one of")),
        ("scan.csv", "x (mm),ratio\n0,0.5\n", ("column 'x (mm)'", "units in the cells")),
        ("scan.csv", 'x,ratio\n0 mm,"0,5"\n', ("reading[0].ratio", "'0,5'")),
        ("scan.csv", "x;ratio\n0 mm;1.234,5\n", ("reading[0].ratio",)),
        ("scan.csv", "ratio\n", ("0 readings",)),
        ("scan.toml", "[[reading]\n", ("not TOML",)),
        ("scan.toml", "reading = 3\n", ("[[reading]]",)),
        ("scan.toml", "[[reading]]\nratio = true\n", ("reading[0].ratio",)),
        ("scan.toml", "[[reading]]\nratio = 0.5\nx = 3\n", ("reading[0].x", "unit")),
        ("scan.toml", '[[reading]]\nratio = 0.5\nstiffness = "3 mm"\n', ("reading[0].stiffness",)),
    ],
)
def test_readings_that_are_refused(tmp_path: Path, name: str, text: str, words: tuple[str, ...]) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError) as refusal:
        read_readings(tmp_path / name, scene(), 0.05)
    for word in words:
        assert word in str(refusal.value)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"inclusion": ()}, "inclusion"),
        ({"inclusion": scene().inclusion * 2}, "target"),
        ({"contact": scene().contact.model_copy(update={"interface": "unilateral"})}, "unilateral"),
        ({"placement": scene().placement.model_copy(update={"tilt": 0.1})}, "tilt"),
    ],
)
def test_kinds_that_are_refused(change: dict[str, object], word: str) -> None:
    with pytest.raises(InputError, match=word):
        estimate(scene().model_copy(update=change), (Reading(0.0, 0.0, 0.7, 0.05),))


def as_file(path: Path, scene_written: Scene) -> Path:
    path.write_text(scene_to_toml(scene_written))
    return path


def test_command_line(tmp_path: Path) -> None:
    file = as_file(tmp_path / "scene.toml", scene())
    ended = run(
        "estimate", file, "--ratio", "0.62", "--noise", "0.01", "--stiffness", "120", "--stiffness-noise", "0.2", "--json"
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr == ""
    output = json.loads(ended.stdout)
    assert output.keys() == {*Estimate.__dataclass_fields__, "youngs_modulus", "provenance"} - {"value"}
    assert output["interval"][0] < output["youngs_modulus"] < output["interval"][1]
    assert output["identifiable"] is True
    said = run("estimate", file, "--ratio", "0.71")
    assert said.returncode == 0
    assert "E_object is not identifiable" in said.stdout
    assert "What can be estimated: depth 9 mm" in said.stdout
    depth = json.loads(run("estimate", file, "--ratio", "0.6", "--unknown", "depth", "--json").stdout)
    assert depth["depth_interval"] == depth["interval"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), ("ratio", "missing")),
        (("--ratio", "0"), ("ratio", "above 0")),
        (("--ratio", "-1"), ("ratio = '-1'", "above 0")),
        (("--ratio", "-1", "--json"), ("ratio = '-1'", "above 0")),
        (("--ratio", "much"), ("ratio", "much")),
        (("--ratio", "0.6", "--noise", "0"), ("noise", "1e-06")),
        (("--ratio", "0.6", "--noise", "nan"), ("noise", "nan")),
        (("--ratio", "0.6", "--stiffness", "80 kg"), ("stiffness", "80 kg")),
        (("--ratio", "0.6", "--unknown", "colour"), ("unknown", "youngs_modulus, diameter, depth")),
        (("--ratio", "0.6", "--accuracy", "2"), ("accuracy", "below 1")),
        (("--ratio", "0.6", "--readings", "scan.csv"), ("exactly one",)),
        (("--readings", "absent.csv"), ("absent.csv", "No such file")),
    ],
)
def test_refusals_are_one_line_and_exit_2(arguments: tuple[str, ...], words: tuple[str, ...], tmp_path: Path) -> None:
    line = refused("estimate", as_file(tmp_path / "scene.toml", scene()), *arguments)
    for word in words:
        assert word in line


def test_a_scene_without_inclusion_is_refused() -> None:
    assert "inclusion" in refused("estimate", REFERENCE / "axisymmetric" / "homogeneous.toml", "--ratio", "0.6")


def test_findings_of_an_exact_reading_are_the_truth() -> None:
    target_model = model(scene(), 0.01)
    value = target_model.predict({"youngs_modulus": np.array([60e3])}).value[0, 0]
    exact = TargetModel(target_model.scene, Measurements.from_readings((Reading(0.0, 0.0, float(np.exp(value)), 0.01),)), 0.01)
    assert search_unknown(exact, "youngs_modulus").best_value == pytest.approx(60e3, rel=1e-4)


class TestLoads:
    """Loads at which finite strain matters: refused, or counted; see ``solver.planning.loads``."""

    @staticmethod
    def scene(force: float) -> Scene:
        return read_scene(EXAMPLES / "scene.toml").model_copy(update={"load": Load(force=force)})

    READ = (Reading(0.0, 0.0, 0.563, 0.01),)

    def test_large_loads_are_refused(self) -> None:
        with pytest.raises(Refusal, match=r"load.force = 2 N: allowed: up to about 0.4\d N.*--linear"):
            estimate(self.scene(2.0), self.READ)

    def test_the_interval_counts_finite_strain(self) -> None:
        """The rule's 0.1 x of the ratio, times eq. PL.7 of 8 mm under 5 mm, goes on top of the model's own error."""
        light, heavy = estimate(self.scene(0.0), self.READ), estimate(self.scene(0.02), self.READ)
        assert light.error_estimate is not None
        assert heavy.error_estimate is not None
        radius, depth = self.scene(0.0).probe.tube_radius, self.scene(0.0).tissue.depth
        covered = 1 + 0.55 * (8 / (5 + 0.05 * 8) - 0.5) ** 1.3
        deep = 0.02 / 93.166  # stiffness: tests/reference/contact
        pressed = evaluate(self.scene(0.02), "axisymmetric")
        x = deep * (math.hypot(1 / radius, 25 * radius / depth**2) + added_by_blocks(self.scene(0.02).probe, pressed, deep))
        assert heavy.error_estimate - light.error_estimate == pytest.approx(0.1 * covered * x, rel=0.03)
        ends = [end for interval in (heavy.interval, light.interval) for end in interval if end is not None]
        assert ends[0] < ends[2] < ends[3] < ends[1]

    def test_linearly_beyond_what_is_known_nothing_is_told(self) -> None:
        estimated = estimate(self.scene(1.0), self.READ, linear=True)
        assert not estimated.identifiable
        assert estimated.interval == (None, None)
        assert any("are unknown at this load" in line for line in estimated.warnings)
