"""Estimates at loads beyond linear elasticity: other codes' readings, the interpolation between few nodes, what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

from geometry import Load, Scene, read_scene
from geometry.common.errors import Refusal
from probe_design.estimation.estimate import estimate
from probe_design.estimation.loaded_track import LoadedModel, LogPrediction, add_load
from probe_design.estimation.measurements import Measurements, Reading
from probe_design.estimation.model import TargetModel
from probe_design.estimation.profile import Track
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


@pytest.mark.parametrize(
    ("reading", "nuisances", "words"),
    [
        (Reading(5e-3, 0.0, 0.6, 0.05), {}, "contact, for larger loads, takes one tumour, read on its axis"),
        (Reading(0.0, 0.0, 0.6, 0.05), {"probe.gap": 0.1}, "takes no numbers that are known only roughly"),
    ],
)
def test_what_contact_cannot_take_is_refused(reading: Reading, nuisances: dict[str, float], words: str) -> None:
    with pytest.raises(Refusal, match=r"load.force = 0.2 N: allowed: up to 0.08\d+ N") as refusal:
        estimate(example(Load(force=0.2)), (reading,), nuisances=nuisances)
    assert words in str(refusal.value)
    assert "--linear" in str(refusal.value)
