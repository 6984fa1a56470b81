"""One recommended design: where no gain is verified it is the start, and table, limits, report and JSON speak of that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geometry.scenes.scene import Scene
from geometry.scenes.variables import changed
from probe_design.design_report.depth_map import DepthMap
from probe_design.design_report.table import caption, columns, heading, rows
from probe_design.design_search.judging import JudgedDesign
from probe_design.design_search.loads import PressedDesign
from probe_design.design_search.outcome import PopulationOptimum
from probe_design.design_search.question import builtin_design
from probe_design.design_search.room import room
from probe_design.design_search.workshop import Robustness
from probe_design.populations.judge import scored
from probe_design.populations.judgement import Judgement, MeanError
from probe_design.populations.tables import CHANNELS

DESIGN = builtin_design().model_copy(
    update={"population": builtin_design().population.model_copy(update={"samples": 4})},
)
NOWHERE = DepthMap(np.ones(1), np.ones(1), np.zeros((1, 1)), np.ones((1, 1)))


@pytest.fixture(scope="module")
def judgement() -> Judgement:
    one = scored(DESIGN.scene, DESIGN)
    lines = {name: replace(one, observable=name) for name in CHANNELS}
    return replace(one, by_observable=lines)


def design_of(scene: Scene, judgement: Judgement, probabilities: list[float], model: float) -> JudgedDesign:
    values = {**judgement.values, "detection": np.array(probabilities)}
    means = {**judgement.means, "detection": float(np.mean(probabilities))}
    errors = {**judgement.errors, "detection": MeanError(0.01, model)}
    pressed = PressedDesign(0.01, 1e-4, 0.01, (1e-14, 1e-13), "force", {"force": 0.01, "gap_closure": 0.02})
    return JudgedDesign(scene, pressed, replace(judgement, values=values, means=means, errors=errors))


def optimum(judgement: Judgement, gain: float) -> PopulationOptimum:
    """The start, and a design of another gap that detects more by a gain of which 0.1 is the model's error."""
    start = design_of(DESIGN.scene, judgement, [0.2, 0.2, 0.2, 0.2], 0.05)
    other = changed(DESIGN.scene, {"probe.gap": 3e-4})
    tried = design_of(other, judgement, [0.2 + gain, 0.2 + gain, 0.2 + gain, 0.2 + gain], 0.05)
    flat = Robustness(0.2, 0.2, 0.2, 0.2)
    return PopulationOptimum(DESIGN, room(DESIGN), start, None, (tried,), (flat, flat), "", True, {}, {}, "none asked for")


def test_without_a_verified_gain_everything_is_of_the_start(judgement: Judgement) -> None:
    found = optimum(judgement, 0.05)
    assert found.status == "no-gain"
    assert found.scene == found.start.scene
    assert list(columns(found)) == ["best tried, no gain", "start, recommended"]
    assert columns(found)["start, recommended"] is found.start
    assert "the start is exported" in heading(found)
    assert found.verdict.startswith("no gain: no design better than the start was verified: the start is exported")
    answer = found.summary([])
    assert answer["recommended"] == "start"
    assert answer["design"] == answer["designs"]["start"] == answer["designs"]["optimum"]
    assert answer["population"]["found"]["detection"] == pytest.approx(0.25)
    assert next(one.active for one in found.limits if one.name == "least gap")


def test_with_a_verified_gain_everything_is_of_the_design_found(judgement: Judgement) -> None:
    found = optimum(judgement, 0.5)
    assert found.status == "improved"
    assert list(columns(found)) == ["start", "recommended"]
    assert found.scene == found.finalists[0].scene
    assert found.summary([])["recommended"] == "optimum"


def test_three_lines_and_both_errors_are_in_every_table(judgement: Judgement) -> None:
    found = optimum(judgement, 0.5)
    table = {row[0]: row[1:] for row in rows(found, dict.fromkeys(columns(found), NOWHERE))}
    assert {"detected of 100, ratio alone *", "detected of 100, stiffness alone", "detected of 100, both"} <= table.keys()
    assert table["* sampling, model error"] == ("± 1.0, ± 5.0", "± 1.0, ± 5.0")
    assert "*: by what the probe is designed for, ratio alone" in caption(found)
    note = found.best.judgement.error_note
    assert "sampling leaves ± 1 of 100 tumours open and the evaluator's model ± 5" in note
    population = found.summary([])["population"]["optimum"]
    assert set(population["by_observable"]) == {"ratio", "stiffness", "both"}
    assert population["detection_error"] == population["detection_sampling_error"] + population["detection_model_error"]
