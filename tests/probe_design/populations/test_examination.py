"""Probes verified: the two evaluators, paired differences, and which errors count."""

from __future__ import annotations

import json

import numpy as np
import pytest

from geometry.common.errors import Refusal
from geometry.scenes.scene_file import scene_from_dict
from geometry.scenes.scene_tables import Load
from probe_design.design_search.population_objective import PopulationObjective
from probe_design.design_search.variables import read_vector
from probe_design.populations.design_file import design_from_dict
from probe_design.populations.examination import examine
from probe_design.populations.objective import Objective
from tests.support.designs import SUPERFICIAL, THREE, example_design, verify

DESIGN = example_design(population={**SUPERFICIAL, "samples": 16}, protocol=THREE)


def test_a_probe_is_verified_on_tumours_that_no_search_used() -> None:
    seen, unseen = examine(DESIGN.scene, DESIGN).evaluate(DESIGN), verify(DESIGN.scene, DESIGN, samples=4)
    assert not set(seen.draw.depth.tolist()) & set(unseen.draw.depth.tolist())
    assert unseen.evaluator == "equivalent-inclusion"
    assert abs(unseen.means["detection"] - seen.means["detection"]) < 3 * np.hypot(
        unseen.errors["detection"].total, seen.errors["detection"].total
    )
    stored = json.loads(json.dumps(unseen.as_dict()))
    assert {"detection", "detection_error", "resolved", "resolved_error", "information", "information_error"} <= stored.keys()


@pytest.mark.slow
def test_more_readings_find_more() -> None:
    noisy = {"white": 0.03, "stiffness_white": 0.03}
    axis = {"positions": ["0 mm"], "stiffness": False}
    scores = []
    for protocol in (axis, {**THREE, "stiffness": False}, THREE):
        design = example_design(population=SUPERFICIAL, protocol=protocol, noise=noisy)
        scores.append(examine(design.scene, design).evaluate(design))
    assert scores[0].means["detection"] < scores[1].means["detection"] < scores[2].means["detection"]
    assert np.all(np.diff([scored_design.means["information"] for scored_design in scores]) > 0)


@pytest.mark.slow
def test_differences_of_two_probes_are_paired() -> None:
    """The same tumours, the same draws: the error of the difference is far below those of both."""
    noise = {"white": 0.04, "stiffness_white": 0.04}
    design = example_design(population={**SUPERFICIAL, "samples": 64}, protocol=THREE, noise=noise)
    first = examine(design.scene, design).evaluate(design)
    second = examine(design.scene.replace({"probe.height": 3.3e-3}), design).evaluate(design)
    gain, error = second.compute_gain(first, design.objective)
    assert gain == pytest.approx(second.means["detection"] - first.means["detection"])
    assert error < 0.5 * first.errors["detection"].total
    assert first.compute_gain(first, design.objective)[0] == 0.0


def test_a_quantile_looks_at_the_hard_tumours() -> None:
    design = example_design(population=SUPERFICIAL, protocol=THREE, objective={"statistic": 0.1})
    scored_design = examine(design.scene, design).evaluate(design)
    assert scored_design.means["detection"] == pytest.approx(np.quantile(scored_design.values["detection"], 0.1))
    assert scored_design.means["detection"] < scored_design.values["detection"].mean()


def test_errors_of_means_are_those_of_repeated_samples() -> None:
    rng = np.random.default_rng(0)
    samples = rng.beta(0.5, 0.5, (2000, 50))
    for objective in (Objective(), Objective(statistic=0.3)):
        spread = np.std([objective.compute_statistic(values) for values in samples])
        assert np.mean([objective.compute_error(values) for values in samples]) == pytest.approx(spread, rel=0.15)


def test_tissues_that_differ_count_in_the_error() -> None:
    """Few tissues with many tumours each are as many samples as tissues, where tumours of one tissue are alike."""
    rng, group = np.random.default_rng(1), np.repeat(np.arange(4), 25)
    spread, stated = [], []
    for _ in range(2000):
        values = rng.standard_normal(4)[group] + 0.1 * rng.standard_normal(100)
        spread.append(values.mean())
        stated.append(Objective().compute_error(values, group))
    assert np.sqrt(np.mean(np.square(stated))) == pytest.approx(np.std(spread), rel=0.1)
    tissues = rng.standard_normal(100)
    assert Objective().compute_error(tissues, group) >= Objective().compute_error(tissues)


def test_a_film_that_is_pulled_on_is_refused_in_words_and_steers_no_search() -> None:
    """A stiff skin on soft fat bends beside the outer block; once it was `force = 1e-4: allowed: a force above 0`."""
    probe = {"inner_radius": "1.5 mm", "outer_radius": "2.6 mm", "gap": "0.3 mm", "height": "2 mm"}
    probe |= {block: {"youngs_modulus": "1 MPa", "poisson_ratio": 0.495} for block in ("inner", "outer")}
    skin = {"thickness": "0.8 mm", "youngs_modulus": "300 kPa", "poisson_ratio": 0.45}
    tissue = {"shape": "half-space", "youngs_modulus": "2.5 kPa", "poisson_ratio": 0.45, "layer": [skin]}
    body = {"diameter": "4 mm", "depth": "6 mm", "youngs_modulus": "30 kPa", "poisson_ratio": 0.45}
    scene = scene_from_dict({"probe": probe, "tissue": tissue, "inclusion": [body], "load": {"force": "0.1 mN"}})
    design = design_from_dict({"scene": scene, "protocol": {"positions": [0.0], "stiffness": False}})
    with pytest.raises(Refusal, match="the inner film is pulled on") as refused:
        verify(scene, design)
    assert "\n" not in str(refused.value)
    objective = PopulationObjective.from_design(design, 4e-3)
    with pytest.raises(Refusal, match="pulled"):
        objective.rule.compute_pressed_design(scene)
    assert objective.evaluate_designs(read_vector(scene)[:, None], (0.495, 0.495))[0] == -np.inf


def test_loads_of_which_nothing_is_known_are_refused() -> None:
    pressed = DESIGN.scene.model_copy(update={"load": Load(force=50.0)})
    with pytest.raises(Refusal, match="load"):
        verify(pressed, DESIGN, samples=1)
