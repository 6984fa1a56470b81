"""Designs for which the load is a variable, against references with finite strain and contact, and laws that hold of them."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from itertools import pairwise

import pytest

from geometry import Load, Scene
from probe_design import optimize
from probe_design.design_report.tumour_report import build_comparison_table
from probe_design.design_search.contact_verification import needs_contact, optimize_load
from probe_design.design_search.tumour_objective import Noise
from probe_design.design_search.tumour_study import TumourStudy, remove_load_limit
from probe_design.design_search.verification import TumourVerification, verify_tumour_design
from solver import evaluate
from tests.support.load_paths import FOLDER, scene_of
from tests.support.scenes import nodule

NOISE = Noise()
EXPECTED = json.loads((FOLDER / "expected.json").read_text())


@cache
def loaded(name: str, force: float) -> tuple[TumourVerification, TumourVerification]:
    """A reference's probe under a force, verified linearly up to the linear limit, and by contact."""
    scene = scene_of(name).model_copy(update={"load": Load(force=force)})
    verified_design = verify_tumour_design(Scene.model_validate(scene), NOISE, "axisymmetric")
    return verified_design, optimize_load(verified_design, NOISE)


def sd(row: dict[str, float], scene: Scene) -> float:
    """PHYSICS.md, section 2: sqrt(v_inner + v_outer) / S, v = g^2 + (q0 / Q)^2, Q = 20 pC/N times the film's force."""
    share = row["ratio"] * scene.probe.inner_area / (row["ratio"] * scene.probe.inner_area + scene.probe.outer_area)
    gain = 0.05**2  # of the ratio, both channels together
    charges = [20e-12 * row["force"] * part for part in (share, 1 - share)]
    return math.sqrt(gain + sum((0.01e-12 / charge) ** 2 for charge in charges)) / row["log_sensitivity"]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "k"), [("example", 3), ("equal-blocks-6kpa", 3)])
def test_contact_verifies_loads_beyond_linear_elasticity(name: str, k: int) -> None:
    row = EXPECTED[name]["rows"][k]
    linear, pressed = loaded(name, row["force"])
    assert linear.pressing.limited_by != "scene"
    assert pressed.evaluator == "contact"
    assert (pressed.pressing.limited_by, pressed.pressing.force) == ("scene", row["force"])
    unsure = row["log_sensitivity_unc"] / row["log_sensitivity"] + 0.01
    assert pressed.lower * (1 - unsure) <= sd(row, pressed.scene) <= pressed.upper * (1 + unsure)
    assert pressed.is_better_than(linear)  # pressing harder tells more


@pytest.mark.slow
def test_beyond_closure_the_gap_is_kept_open() -> None:
    closure, unsure = (EXPECTED["paper"][key] for key in ("gap_closure_force", "gap_closure_force_unc"))
    linear, pressed = loaded("paper", 1.5 * closure)
    assert pressed.pressing.limited_by == "gap closure"
    assert pressed.pressing.load.force == pressed.pressing.force
    assert linear.pressing.force < pressed.pressing.force < closure
    assert pressed.pressing.force == pytest.approx(0.9 * closure, rel=0.05 + unsure / closure)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_wider_limit_never_makes_a_design_worse() -> None:
    """Below linear elasticity's end, just beyond it, far beyond it, and beyond what it can be pressed."""
    verified_designs = [loaded("example", force)[1] for force in (0.01, 0.03, 0.031, 0.09, 3.0)]
    values = [verified_design.value for verified_design in verified_designs]
    assert all(wider <= tighter for tighter, wider in pairwise(values)), values
    assert [verified_design.evaluator for verified_design in verified_designs[1:]] == ["contact"] * 4
    assert verified_designs[-1].pressing.limited_by in ("depth", "gap closure")
    assert verified_designs[-1].pressing.force < 0.5


@pytest.mark.slow
def test_the_verification_s_result_is_that_of_contact_alone() -> None:
    _, pressed = loaded("example", 0.09)
    alone = evaluate(pressed.loaded_scene, "contact")
    assert pressed.evaluator == "contact"
    errors = (pressed.result.error_estimate or 0.0) + (alone.error_estimate or 0.0)
    assert pressed.result.ratio == pytest.approx(alone.ratio, rel=errors)
    forces = [
        pressed.scene.probe.inner_area * (alone.stress_inner or 0.0),
        pressed.scene.probe.outer_area * (alone.stress_outer or 0.0),
    ]
    assert sum(forces) == pytest.approx(0.09, rel=errors)
    noise = math.hypot(0.05, *(0.01e-12 / (20e-12 * force) for force in forces))
    value = noise / (alone.log_sensitivity or math.nan)
    assert pressed.lower < value < pressed.upper
    assert pressed.value == pytest.approx(value, rel=0.02)


@pytest.mark.slow
def test_an_indentation_is_a_limit_too() -> None:
    scene = scene_of("example").model_copy(update={"load": Load(indentation=1e-3)})
    start = verify_tumour_design(Scene.model_validate(scene), NOISE, "axisymmetric")
    pressed = optimize_load(start, NOISE)
    assert (pressed.pressing.load.indentation, pressed.pressing.load.force, pressed.pressing.limited_by) == (1e-3, None, "scene")
    row = next(row for row in EXPECTED["example"]["rows"] if row["indentation"] == 1.25e-3)
    assert start.pressing.force < pressed.pressing.force < row["force"]
    assert pressed.is_better_than(start)


def test_a_gain_of_more_load_counts_beyond_twice_its_error() -> None:
    linear, _ = loaded("example", 0.01)
    loose = replace(linear, value=1.0, lower=0.98, upper=1.02)

    def make_candidate(value: float, error: float) -> TumourVerification:
        return replace(linear, value=value, lower=value - error, upper=value + error, linear=loose)

    gain, error = make_candidate(0.9, 0.03).compute_gain(loose)
    assert gain == pytest.approx(0.1)
    assert error == pytest.approx(0.9 * math.hypot(0.03 / 0.9, 0.02))
    assert not make_candidate(0.93, 0.03).is_better_than(loose)  # 0.96 < 0.98, but no 0.07 beyond twice 0.035
    assert make_candidate(0.9, 0.03).is_better_than(loose)
    assert replace(make_candidate(0.93, 0.03), linear=None).is_better_than(loose)  # bounds alone count within linear elasticity
    assert make_candidate(0.9, math.inf).compute_gain(loose)[1] == math.inf
    assert not make_candidate(0.9, math.inf).is_better_than(loose)


@pytest.mark.slow
def test_finalists_do_not_hang_on_the_limit_of_the_load() -> None:
    """A search without a limit, each design then under as much of the scene's load as linear elasticity allows."""
    free, _ = loaded("example", 1e9)
    for force in (5e-3, 0.2):
        scene = free.scene.model_copy(update={"load": Load(force=force)})
        limited_scene = TumourStudy.from_scene(scene, evaluator="axisymmetric").restore_load(free)
        repeated = verify_tumour_design(scene, NOISE, "axisymmetric")
        assert (limited_scene.scene.load, limited_scene.pressing, limited_scene.value) == (
            scene.load,
            repeated.pressing,
            repeated.value,
        )
        assert remove_load_limit(limited_scene.scene) == free.scene


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_tighter_limit_of_the_load_never_gives_a_better_optimum() -> None:
    """The whole loop: within linear elasticity, and where all designs ask for more."""
    optima = [optimize(pressed_nodule(force), starts=1, outer_radius=4.5e-3) for force in (1e-3, 0.1)]
    best = [optimum.finalists[0].value for optimum in optima]
    assert all(wider <= tighter for tighter, wider in pairwise(best)), best
    assert optima[0].finalists[0].evaluator == "axisymmetric"
    last = optima[-1]
    assert last.best_tried.evaluator == last.start.evaluator == "contact"
    assert last.best_tried.linear is not None
    assert last.best_tried.value < last.best_tried.linear.value
    text = last.build_summary([])
    assert text["evaluator"] == text["baseline_evaluator"] == "contact"
    gain, error = last.best.compute_gain(last.best.linear or last.best)
    assert (text["under_load"]["gain"], text["under_load"]["gain_error"]) == pytest.approx((gain, error))
    assert text["force_limited_by"] == last.best.pressing.limited_by
    table = build_comparison_table(last)
    rows = {row[0]: row[len(last.list_columns())] for row in table.rows}  # the recommended design is the last column
    assert rows["force limited by"] == last.best.pressing.limited_by
    assert float(rows["gain of more load, %"]) == pytest.approx(100 * gain, rel=0.01)
    assert any("where linear elasticity ends" in line for line in last.warnings)
    assert all(
        verify_tumour_design(optimum.loaded_scene, NOISE, "axisymmetric").pressing.force <= optimum.pressing.force
        for optimum in last.finalists[:2]
    )


def pressed_nodule(force: float) -> Scene:
    return nodule().model_copy(update={"load": Load(force=force)})


def test_a_small_load_asks_for_no_contact() -> None:
    small, unloaded = loaded("example", 0.01)
    assert not needs_contact(small)
    assert unloaded is small
