"""One recommended design: where no gain is verified it is the start, and table, limits, report and JSON speak of that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geometry.scenes.scene import Scene
from probe_design.design_report.depth_map import DepthMap
from probe_design.design_report.population_report import build_population_table, describe_conditions
from probe_design.design_search.choices import ChoiceSearch
from probe_design.design_search.loads import PressedDesign
from probe_design.design_search.optimum import PopulationOptimum
from probe_design.design_search.robustness import Robustness
from probe_design.design_search.search_space import build_search_space
from probe_design.design_search.verification import PopulationVerification
from probe_design.populations.design_file import read_builtin_design
from probe_design.populations.examination import examine
from probe_design.populations.performance import MeanError, Performance
from probe_design.populations.tables import CHANNEL_INDICES

DESIGN = read_builtin_design().model_copy(
    update={"population": read_builtin_design().population.model_copy(update={"samples": 4})},
)
NOWHERE = DepthMap(np.ones(1), np.ones(1), np.zeros((1, 1)), np.ones((1, 1)))


@pytest.fixture(scope="module")
def performance() -> Performance:
    verified = examine(DESIGN.scene, DESIGN).evaluate(DESIGN)
    lines = {name: replace(verified, channel_set=name) for name in CHANNEL_INDICES}
    return replace(verified, by_channels=lines)


def design_of(scene: Scene, performance: Performance, probabilities: list[float], model: float) -> PopulationVerification:
    values = {**performance.values, "detection": np.array(probabilities)}
    means = {**performance.means, "detection": float(np.mean(probabilities))}
    errors = {**performance.errors, "detection": MeanError(0.01, model)}
    pressed = PressedDesign(0.01, 1e-4, 0.01, (1e-14, 1e-13), "force", {"force": 0.01, "gap_closure": 0.02})
    return PopulationVerification(
        scene, pressed, replace(performance, values=values, means=means, errors=errors), DESIGN.objective, DESIGN.protocol
    )


def optimum(performance: Performance, gain: float) -> PopulationOptimum:
    """The start, and a design of another gap that detects more by a gain of which 0.1 is the model's error."""
    start = design_of(DESIGN.scene, performance, [0.2, 0.2, 0.2, 0.2], 0.05)
    moved = DESIGN.scene.replace({"probe.gap": 3e-4})
    tried = design_of(moved, performance, [0.2 + gain, 0.2 + gain, 0.2 + gain, 0.2 + gain], 0.05)
    flat = Robustness(0.2, 0.2, 0.2, 0.2)
    search = ChoiceSearch((), "", True, {})
    return PopulationOptimum(DESIGN, build_search_space(DESIGN), start, (tried,), search, None, (flat, flat), "none asked for")


def test_without_a_verified_gain_everything_is_of_the_start(performance: Performance) -> None:
    best = optimum(performance, 0.05)
    assert best.status == "no-gain"
    assert best.scene == best.start.scene
    assert list(best.list_columns()) == ["best tried, no gain", "start, recommended"]
    assert best.list_columns()["start, recommended"] is best.start
    assert best.verdict.startswith("no gain: no design better than the start was verified: the start is exported")
    answer = best.build_summary([])
    assert answer["recommended"] == "start"
    assert answer["design"] == answer["designs"]["start"] == answer["designs"]["optimum"]
    assert answer["population"]["found"]["detection"] == pytest.approx(0.25)
    assert next(limit.active for limit in best.limits if limit.name == "least gap")


def test_with_a_verified_gain_everything_is_of_the_design_found(performance: Performance) -> None:
    best = optimum(performance, 0.5)
    assert best.status == "improved"
    assert list(best.list_columns()) == ["start", "recommended"]
    assert best.scene == best.finalists[0].scene
    assert best.build_summary([])["recommended"] == "optimum"


def test_three_lines_and_both_errors_are_in_every_table(performance: Performance) -> None:
    best = optimum(performance, 0.5)
    table = {row[0]: row[1:] for row in build_population_table(best, dict.fromkeys(best.list_columns(), NOWHERE)).rows}
    assert {"detected of 100, ratio alone *", "detected of 100, stiffness alone", "detected of 100, both"} <= table.keys()
    assert table["* sampling, model error"] == ("± 1.0, ± 5.0", "± 1.0, ± 5.0")
    assert "*: by what the probe is designed for, ratio alone" in describe_conditions(best)
    note = best.best.performance.error_note
    assert "± 1 of 100 tumours by sampling, ± 5 by the model" in note
    population = best.build_summary([])["population"]["optimum"]
    assert set(population["by_channels"]) == {"ratio", "stiffness", "both"}
    assert population["detection_error"] == population["detection_sampling_error"] + population["detection_model_error"]
