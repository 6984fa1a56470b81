"""The objective by hand; each design's force against finite-strain references and simple compression; what noise means."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from geometry import Film, InputError, Load, read_scene
from probe_design.data.builtin import builtin_scene
from probe_design.data.noise import NOISE, RESOLVED, of_channel
from probe_design.maps.sphere_effects import Thresholds
from probe_design.optimisation.candidate import answered, candidate
from probe_design.optimisation.design_space import variables
from probe_design.optimisation.objective import Noise, objective
from probe_design.optimisation.optimize import optimize
from probe_design.optimisation.pressing import pressing, pressing_force
from solver import evaluate
from solver.planning.coarse_model import CoarseModel
from solver.planning.load_limits import load_rule
from solver.planning.loads import LoadRule
from tests.support.paths import EXAMPLES, REFERENCE, SCENE
from tests.support.program import run


def test_objective_by_hand() -> None:
    # 5 % on the ratio; q0 = 0.01 pC; Q = 20 pC/N * 0.1 N * share = 1.5 and 0.5 pC
    by_hand = 0.1**2 / (0.05**2 + (0.01 / 1.5) ** 2 + (0.01 / 0.5) ** 2)
    assert Noise().information(0.1, 0.75, 0.1) == pytest.approx(by_hand, rel=1e-12)
    assert objective(by_hand) == pytest.approx(by_hand**-0.5)
    assert objective(0.0) == math.inf


def test_two_channels_of_that_gain_error_give_the_ratio_its_noise() -> None:
    inner, outer = 1 + of_channel(0.05) * np.random.default_rng(3).standard_normal((2, 1_000_000))
    assert np.std(np.log(inner / outer)) == pytest.approx(0.05, rel=0.01)


def test_film_s_charge_counts() -> None:
    scene = builtin_scene()
    assert Noise.of(scene) == Noise(charge_per_force=20e-12)
    strong = scene.probe.model_copy(update={"film": Film(d33=-33e-12)})
    assert Noise.of(scene.model_copy(update={"probe": strong})).charge_per_force == 33e-12


def test_without_charge_noise_the_objective_is_detectability_s_and_all_verbs_have_one_noise() -> None:
    """Standard deviation of ln E_object = noise / S, eq. MA.2; defaults are one."""
    assert Thresholds().noise == Noise().ratio == NOISE
    assert Thresholds().resolved == RESOLVED == 0.5
    assert objective(Noise(charge=0.0).information(0.1, 0.7, 1.0)) == pytest.approx(NOISE / 0.1)
    for verb in ("optimize", "detectability", "estimate"):
        text = re.sub(r"\s+", " ", run(verb, "--help").stdout)
        assert f"--noise TEXT Relative standard deviation of one reading of the ratio. [default: {NOISE:g}]" in text


@pytest.mark.parametrize("verb", ["optimize", "detectability", "estimate"])
def test_what_is_no_noise_is_refused_alike(verb: str, tmp_path: Path) -> None:
    more = {"optimize": ("-o", f"{tmp_path}/out"), "estimate": ("--ratio", "0.6"), "detectability": ()}[verb]
    for noise in ("0", "11", "nan", "-0.1"):
        ended = run(verb, SCENE, *more, "--noise", noise)
        assert ended.returncode == 2
        assert "allowed: from 1e-06 to 10: relative" in ended.stderr


def test_noise_is_printed() -> None:
    for arguments in (("detectability", SCENE, "--points", "2", "--accuracy", "0.1"), ("estimate", SCENE, "--ratio", "0.62")):
        assert "noise 0.02 on the ratio" in re.sub(r"\s+", " ", run(*arguments, "--noise", "0.02").stdout)
        told = json.loads(run(*arguments, "--noise", "0.02", "--json").stdout)["noise"]
        assert told == (0.02 if arguments[0] == "detectability" else [0.02])


def loaded(load: Load) -> tuple[float, str]:
    """The force on the probe of examples/scene.toml that a load comes to, and what sets it."""
    scene = read_scene(EXAMPLES / "scene.toml").model_copy(update={"load": load})
    pressed = candidate(scene, Noise(), "axisymmetric").pressing
    return pressed.force, pressed.by


def test_an_indentation_counts_as_its_force() -> None:
    stiffness = evaluate(read_scene(EXAMPLES / "scene.toml"), "axisymmetric").stiffness
    assert loaded(Load(indentation=1e-6)) == (pytest.approx(1e-6 * stiffness), "scene")
    assert loaded(Load(indentation=2e-6))[0] == pytest.approx(2e-6 * stiffness)
    assert loaded(Load(force=0.001)) == (0.001, "scene")


def test_a_load_beyond_linear_elasticity_is_lowered_to_what_references_allow() -> None:
    """At 1/20 of the load that closes the gap and at a tenth of the radius the ratio is off by 1 % at most (reference)."""
    found = json.loads((REFERENCE / "contact" / "expected.json").read_text())["example"]
    scene = read_scene(REFERENCE / "contact" / "example.toml").model_copy(update={"load": Load(force=1.0)})
    totals = answered(scene, "axisymmetric").films[0].totals
    pressed = pressing(scene, float(totals.sum()), load_rule(scene))
    assert pressed.by in ("strain", "gap closure")
    assert pressed.load == Load(force=pressed.force)
    below = [row for row in found["rows"] if row["force"] <= 1.4 * pressed.force]  # a little beyond, where the first row is
    assert below
    for row in below:
        assert row["ratio"] == pytest.approx(found["small_load"]["ratio"], rel=0.01)


def test_search_and_judge_press_alike() -> None:
    """With all the rule's limits in turn: the scene's load, the tissue's depth, soft blocks, closure."""
    for scene in (builtin_scene(), *(read_scene(REFERENCE / "contact" / f"{name}.toml") for name in ("paper", "example"))):
        for load in (Load(force=1e-6), Load(force=100.0), Load(indentation=1e-3)):
            asked = scene.model_copy(update={"load": load})
            rough, totals = CoarseModel.of(asked), np.array([3.0, 5.0])
            closure = float(totals.sum()) * scene.probe.gap / rough.approach
            rule = LoadRule.of(asked, totals, closure)
            one = pressing(asked, rule.stiffness, rule).force
            other = pressing_force(asked, variables(asked), scene.probe.tube_radius, totals, rough.approach)
            assert float(other) == pytest.approx(one, rel=0.01)  # loads that the rule sets are rounded down to three digits


def test_no_load_is_refused() -> None:
    for load in (Load(force=0.0), Load(indentation=0.0)):
        with pytest.raises(InputError, match="above 0"):
            optimize(read_scene(SCENE).model_copy(update={"load": load}), lambda *_: None)
