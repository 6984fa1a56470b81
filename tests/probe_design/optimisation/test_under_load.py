"""Designs for which the load is a variable, against references with finite strain and contact, and laws that hold of them."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import pairwise

import pytest

from geometry import Load, Scene
from probe_design.optimisation.candidate import Candidate, candidate
from probe_design.optimisation.comparison import level_rows
from probe_design.optimisation.loaded_candidate import asks_for_contact, under_load
from probe_design.optimisation.loaded_search import limited, unlimited
from probe_design.optimisation.objective import Noise
from probe_design.optimisation.optimize import optimize
from probe_design.optimisation.report import summary
from solver import evaluate
from tests.support.load_paths import FOLDER, scene_of
from tests.support.scenes import nodule

NOISE = Noise()
EXPECTED = json.loads((FOLDER / "expected.json").read_text())


def loaded(name: str, force: float) -> tuple[Candidate, Candidate]:
    """A reference's probe under a force, judged linearly as far as that goes and by contact."""
    scene = scene_of(name).model_copy(update={"load": Load(force=force)})
    one = candidate(Scene.model_validate(scene), NOISE, "axisymmetric")
    return one, under_load(one, NOISE)


def sd(row: dict[str, float], scene: Scene) -> float:
    """PHYSICS.md, section 2: sqrt(v_inner + v_outer) / S, v = g^2 + (q0 / Q)^2, Q = 20 pC/N times the film's force."""
    share = row["ratio"] * scene.probe.inner_area / (row["ratio"] * scene.probe.inner_area + scene.probe.outer_area)
    gain = 0.05**2  # of the ratio, both channels together
    charges = [20e-12 * row["force"] * part for part in (share, 1 - share)]
    return math.sqrt(gain + sum((0.01e-12 / charge) ** 2 for charge in charges)) / row["log_sensitivity"]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "k"), [("example", 3), ("equal-blocks-6kpa", 3)])
def test_contact_judges_what_linear_elasticity_does_not_answer_for(name: str, k: int) -> None:
    row = EXPECTED[name]["rows"][k]
    linear, found = loaded(name, row["force"])
    assert linear.pressing.by != "scene"
    assert found.judged.evaluator == "contact"
    assert (found.pressing.by, found.pressing.force) == ("scene", row["force"])
    unsure = row["log_sensitivity_unc"] / row["log_sensitivity"] + 0.01
    assert found.least * (1 - unsure) <= sd(row, found.scene) <= found.most * (1 + unsure)
    assert found.beats(linear)  # pressing harder tells more


@pytest.mark.slow
def test_beyond_closure_the_gap_is_kept_open() -> None:
    closure, unsure = (EXPECTED["paper"][key] for key in ("gap_closure_force", "gap_closure_force_unc"))
    linear, found = loaded("paper", 1.5 * closure)
    assert found.pressing.by == "gap closure"
    assert found.pressing.load.force == found.pressing.force
    assert linear.pressing.force < found.pressing.force < closure
    assert found.pressing.force == pytest.approx(0.9 * closure, rel=0.05 + unsure / closure)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_wider_limit_never_makes_a_design_worse() -> None:
    """Below linear elasticity's end, just beyond it, far beyond it, and beyond what it can be pressed."""
    found = [loaded("example", force)[1] for force in (0.01, 0.03, 0.031, 0.05, 0.12, 0.3, 3.0)]
    values = [one.judged_objective for one in found]
    assert all(wider <= tighter for tighter, wider in pairwise(values)), values
    assert [one.judged.evaluator for one in found[1:]] == ["contact"] * 6
    assert found[-1].pressing.by in ("depth", "gap closure")
    assert found[-1].pressing.force < 0.5


@pytest.mark.slow
def test_what_is_judged_is_what_the_level_says_when_it_is_asked_alone() -> None:
    _, found = loaded("example", 0.09)
    alone = evaluate(found.pressed, "contact")
    assert found.judged.evaluator == "contact"
    errors = (found.judged.error_estimate or 0.0) + (alone.error_estimate or 0.0)
    assert found.judged.ratio == pytest.approx(alone.ratio, rel=errors)
    forces = [
        found.scene.probe.inner_area * (alone.stress_inner or 0.0),
        found.scene.probe.outer_area * (alone.stress_outer or 0.0),
    ]
    assert sum(forces) == pytest.approx(0.09, rel=errors)
    noise = math.hypot(0.05, *(0.01e-12 / (20e-12 * force) for force in forces))
    value = noise / (alone.log_sensitivity or math.nan)
    assert found.least < value < found.most
    assert found.judged_objective == pytest.approx(value, rel=0.02)


@pytest.mark.slow
def test_an_indentation_is_a_limit_too() -> None:
    scene = scene_of("example").model_copy(update={"load": Load(indentation=1e-3)})
    one = candidate(Scene.model_validate(scene), NOISE, "axisymmetric")
    found = under_load(one, NOISE)
    assert (found.pressing.load.indentation, found.pressing.load.force, found.pressing.by) == (1e-3, None, "scene")
    row = next(row for row in EXPECTED["example"]["rows"] if row["indentation"] == 1.25e-3)
    assert one.pressing.force < found.pressing.force < row["force"]
    assert found.beats(one)


def test_a_gain_of_more_load_counts_beyond_twice_its_error() -> None:
    linear, _ = loaded("example", 0.01)
    loose = replace(linear, judged_objective=1.0, least=0.98, most=1.02)

    def more(value: float, error: float) -> Candidate:
        return replace(linear, judged_objective=value, least=value - error, most=value + error, linear=loose)

    gain, error = more(0.9, 0.03).gain_over(loose)
    assert gain == pytest.approx(0.1)
    assert error == pytest.approx(0.9 * math.hypot(0.03 / 0.9, 0.02))
    assert not more(0.93, 0.03).beats(loose)  # 0.96 < 0.98, but no 0.07 beyond twice 0.035
    assert more(0.9, 0.03).beats(loose)
    assert replace(more(0.93, 0.03), linear=None).beats(loose)  # bounds alone count within linear elasticity
    assert more(0.9, math.inf).gain_over(loose)[1] == math.inf
    assert not more(0.9, math.inf).beats(loose)


def test_finalists_do_not_hang_on_the_limit_of_the_load() -> None:
    """A search without a limit, each design then under as much of the scene's load as linear elasticity answers for."""
    free, _ = loaded("example", 1e9)
    for force in (5e-3, 0.2):
        scene = free.scene.model_copy(update={"load": Load(force=force)})
        own = limited(free, scene, NOISE, "axisymmetric")
        again = candidate(scene, NOISE, "axisymmetric")
        assert (own.scene.load, own.pressing, own.judged_objective) == (scene.load, again.pressing, again.judged_objective)
        assert unlimited(own.scene) == free.scene


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_tighter_limit_of_the_load_never_gives_a_better_optimum() -> None:
    """The whole loop: within linear elasticity, where only some designs ask for more, and where all do."""
    found = [optimize(pressed_nodule(force), lambda *_: None, starts=1, outer_radius=4.5e-3) for force in (1e-3, 0.03, 0.1)]
    best = [one.candidates[0].judged_objective for one in found]
    assert all(wider <= tighter for tighter, wider in pairwise(best)), best
    assert found[0].candidates[0].judged.evaluator == "axisymmetric"
    last = found[-1]
    assert last.found.judged.evaluator == last.baseline.judged.evaluator == "contact"
    assert last.found.linear is not None
    assert last.found.judged_objective < last.found.linear.judged_objective
    told = summary(last, [])
    assert told["evaluator"] == told["baseline_evaluator"] == "contact"
    gain, error = last.best.gain_over(last.best.linear or last.best)
    assert (told["under_load"]["gain"], told["under_load"]["gain_error"]) == pytest.approx((gain, error))
    assert told["force_limited_by"] == last.best.pressing.by
    rows = {name: found for name, _, found, _ in level_rows(last)}
    assert rows["force limited by"] == last.found.pressing.by
    assert float(rows["gain of more load, %"]) == pytest.approx(100 * gain, rel=0.01)
    assert any("where linear elasticity ends" in line for line in last.remarks)
    assert all(candidate(one.pressed, NOISE, "axisymmetric").pressing.force <= one.pressing.force for one in last.candidates[:2])


def pressed_nodule(force: float) -> Scene:
    return nodule().model_copy(update={"load": Load(force=force)})


def test_a_small_load_asks_for_no_contact() -> None:
    one, same = loaded("example", 0.01)
    assert not asks_for_contact(one)
    assert same is one
