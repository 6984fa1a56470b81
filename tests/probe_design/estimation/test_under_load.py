"""Estimates at loads beyond linear elasticity: other codes' readings, the interpolation between few nodes, what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from geometry import Load, Scene, read_scene
from geometry.common.errors import InputError, Refusal
from probe_design.estimation.estimate import estimate
from probe_design.estimation.loaded_track import LoadedModel, LogPrediction, add_load
from probe_design.estimation.measurements import Measurements, Reading, read_readings
from probe_design.estimation.model import TargetModel
from probe_design.estimation.profile import Track
from solver import evaluate
from solver.contact.evaluator import ContactEvaluator
from tests.support.paths import EXAMPLES, REFERENCE

EXPECTED = json.loads((REFERENCE / "contact" / "expected.json").read_text())


def example(load: Load) -> Scene:
    return read_scene(EXAMPLES / "scene.toml").model_copy(update={"load": load})


@pytest.mark.slow
def test_a_reading_of_other_codes_is_inverted_right() -> None:
    """At 2.5 mm, 0.23 N, where a linear inversion is 24 % off (reference/contact, by codes that are not ours)."""
    scene = read_scene(REFERENCE / "contact" / "example.toml")
    row = next(row for row in EXPECTED["example"]["rows"] if row["indentation"] == 0.0025)
    read, truth = (Reading(0.0, 0.0, row["ratio"], 0.01),), scene.inclusion[0].youngs_modulus
    estimated = estimate(scene.model_copy(update={"load": Load(indentation=0.0025)}), read)
    assert estimated.evaluator == "contact"
    assert estimated.value is not None
    assert estimated.error_estimate is not None
    low, high = estimated.interval
    assert (low or 0.0) < truth < (high or np.inf)
    tolerance = estimated.error_estimate + row["ratio_unc"] / row["ratio"]
    assert abs(np.log(estimated.value / truth)) <= tolerance / (row["log_sensitivity"] - 0.1 * tolerance)
    linear = estimate(scene.model_copy(update={"load": Load(force=0.0)}), read).value
    assert linear is not None
    assert linear < 0.85 * truth
    assert abs(np.log(estimated.value / truth)) < abs(np.log(linear / truth)) / 2


class MadeUp(LoadedModel):
    """An evaluator whose change by the load is known at all moduli, and that ends somewhere."""

    ends = 1e-2  # of the tissue's modulus: softer targets cannot be pressed

    def prepare(self, at_rest: Track) -> None:
        """Know the linear predictions, and what was asked for."""
        self.track_at_rest, self.requests = at_rest, list[float]()

    @staticmethod
    def change(x: np.ndarray) -> np.ndarray:
        """What the load changes: no polynomial in the track's coordinate."""
        return np.asarray(0.2 * np.exp(0.8 * x))

    def predict(self, value: float) -> LogPrediction | None:
        self.requests.append(value)
        if value < self.ends * self.model.host.youngs_modulus:
            raise Refusal("load.force", "0.2 N", "less")
        k = int(np.argmin(np.abs(self.track_at_rest.compute_values(self.track_at_rest.x) / value - 1)))
        return self.track_at_rest.predicted.value[k] + self.change(self.track_at_rest.x[k]), np.array([1e-3])


def made_up(noise: float) -> tuple[Track, Track, MadeUp]:
    reading = Reading(0.0, 0.0, 0.6, noise)
    model = TargetModel(example(Load(force=0.2)), Measurements.from_readings((reading,)), 0.01)
    loaded = MadeUp(model, "youngs_modulus", 0.01)
    at_rest = Track.from_model(loaded.unloaded_model, "youngs_modulus")
    loaded.prepare(at_rest)
    return at_rest, add_load(at_rest, loaded), loaded


def test_between_nodes_the_change_is_off_by_no_more_than_its_bound() -> None:
    at_rest, estimated, loaded = made_up(1e-3)
    x = np.concatenate(estimated.runs)
    wanted = at_rest.interpolate(x)[0] + loaded.change(x)[:, None]
    bound = np.interp(x, estimated.x, estimated.predicted.bound[:, 0])
    assert np.all(np.abs(estimated.interpolate(x)[0] - wanted)[:, 0] <= bound)
    assert len(set(loaded.requests)) < len(at_rest.x)
    assert estimated.evaluator == "contact"


def test_noise_says_how_many_nodes_are_asked_for() -> None:
    counts = [len(set(made_up(noise)[2].requests)) for noise in (1e-4, 0.1)]
    assert counts[1] < counts[0]


def test_what_cannot_be_pressed_is_not_searched() -> None:
    _, estimated, loaded = made_up(0.01)
    assert estimated.predicted.resolved.tolist() == (estimated.compute_values(estimated.x) >= 0.999 * loaded.ends * 6e3).tolist()


def test_stiffnesses_that_the_model_knows_less_well_are_left_out_under_load_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def tell_roughly(self: LoadedModel, value: float) -> LogPrediction:
        return np.log(np.full(len(self.model.data.value), 0.6)), np.full(len(self.model.data.value), 1e-3)

    monkeypatch.setattr(LoadedModel, "predict", tell_roughly)
    estimated = estimate(example(Load(force=0.2)), (Reading(0.0, 0.0, 0.6, 0.05, stiffness=95.0, stiffness_noise=1e-6),))
    assert estimated.evaluator == "contact"
    assert any("1 stiffnesses left out" in text for text in estimated.warnings)


OFF_AXIS = json.loads((REFERENCE / "contact" / "off_axis.json").read_text())["rows"]


@pytest.mark.slow
def test_readings_off_the_axis_are_inverted_right() -> None:
    """What the tumour changes is that of NGSolve in three dimensions at 0.2 outer radii; without it the reading is a baseline."""
    is_wanted = "base_0.5", 5.0, 0.2
    keys = "case", "contrast", "indentation_over_outer_radius"
    row = next(row for row in OFF_AXIS if tuple(row[key] for key in keys) == is_wanted)
    scene, change = Scene.from_tables(row["scene"]), row["change_of_ln_ratio"]
    blank = ContactEvaluator().solve(scene.model_copy(update={"inclusion": ()}), 0.01).films[0]
    ratio = float(blank.totals[0] / blank.totals[1] * scene.probe.outer_area / scene.probe.inner_area)
    readings = (Reading(0.0, 0.0, ratio, 1e-3, blank=True), Reading(0.0, 0.0, ratio * np.exp(change["value"]), 0.01))
    truth = scene.inclusion[0].youngs_modulus
    estimated = estimate(scene, readings, accuracy=0.01)  # as the baseline reading was computed
    assert estimated.evaluator == "contact"
    assert estimated.value is not None
    low, high = estimated.interval
    assert (low or 0.0) < truth < (high or np.inf)
    sensitivity = row["log_sensitivity"]["value"]
    assert abs(np.log(estimated.value / truth)) < 0.03 * change["value"] / sensitivity
    # a baseline of the linear level, so that only what the tumour changes differs
    light = scene.model_copy(update={"load": Load(force=0.0)})
    ratio = evaluate(light.model_copy(update={"inclusion": ()}), "axisymmetric").ratio or 0.0
    readings = (Reading(0.0, 0.0, ratio, 1e-3, blank=True), Reading(0.0, 0.0, ratio * np.exp(change["value"]), 0.01))
    linear = estimate(light, readings).value
    assert linear is not None
    assert abs(np.log(linear / truth)) > 0.05 * change["value"] / sensitivity


@pytest.mark.slow
def test_readings_at_several_loads_are_several_observables() -> None:
    """Together they narrow the interval, and what they say of the modulus is what their prediction was made of."""
    scene = example(Load(force=0.1)).replace({"inclusion.x": 4e-3})
    ratios = {force: evaluate(scene.replace({"load.force": force}), "contact").ratio or 0.0 for force in (0.05, 0.1)}
    readings = tuple(Reading(0.0, 0.0, ratio, 0.01, force=force) for force, ratio in ratios.items())
    both, *alone = (estimate(scene, chosen) for chosen in (readings, readings[:1], readings[1:]))
    widths = [np.log((result.interval[1] or 0.0) / (result.interval[0] or np.inf)) for result in (both, *alone)]
    assert widths[0] < min(widths[1:])
    for result in (both, *alone):
        assert result.value == pytest.approx(scene.inclusion[0].youngs_modulus, rel=0.02)


@pytest.mark.parametrize("load", [Load(indentation=1e-4), Load(force=0.05, preload=0.01)])
def test_a_force_is_a_press_from_zero_to_it(load: Load, tmp_path: Path) -> None:
    path = tmp_path / "readings.csv"
    path.write_text("ratio,noise,force\n0.6,0.05,0.1 N\n")
    with pytest.raises(InputError, match=r"force = '0.1 N': allowed: nothing in a scene with load"):
        read_readings(path, example(load))


def test_faces_that_slide_are_refused_off_the_axis() -> None:
    scene = example(Load(force=0.2)).replace({"contact.interface": "frictionless"})
    with pytest.raises(Refusal, match=r"load.force = 0.2 N: allowed: up to 0.0\d+ N") as refusal:
        estimate(scene, (Reading(5e-3, 0.0, 0.6, 0.05),))
    assert "where faces slide" in str(refusal.value)
    assert "--linear" in str(refusal.value)
