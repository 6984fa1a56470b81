"""The objective by hand; each design's force against finite-strain references and simple compression; what noise means."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from geometry import Film, InputError, Load, read_scene
from probe_design import optimize
from probe_design.data.builtin import read_builtin_scene
from probe_design.data.noise import DEFAULT_NOISE, MAX_RESOLVED_LOG_SD
from probe_design.design_search.loads import compute_pressing
from probe_design.design_search.tumour_objective import Noise, compute_standard_deviation
from probe_design.design_search.tumour_study import TumourStudy
from probe_design.design_search.variables import ProbeSizes
from probe_design.design_search.verification import evaluate_films, verify_tumour_design
from probe_design.maps.sphere_effects import Thresholds
from solver import evaluate
from solver.planning.coarse_model import CoarseModel
from solver.planning.load_limits import build_load_rule
from solver.planning.loads import LoadRule
from tests.support.paths import EXAMPLES, REFERENCE, SCENE
from tests.support.program import run


def test_objective_by_hand() -> None:
    # 5 % on the ratio; q0 = 0.01 pC; Q = 20 pC/N * 0.1 N * share = 1.5 and 0.5 pC
    by_hand = 0.1**2 / (0.05**2 + (0.01 / 1.5) ** 2 + (0.01 / 0.5) ** 2)
    assert Noise().compute_information(0.1, 0.75, 0.1) == pytest.approx(by_hand, rel=1e-12)
    assert compute_standard_deviation(by_hand) == pytest.approx(by_hand**-0.5)
    assert compute_standard_deviation(0.0) == math.inf


def test_two_channels_of_that_gain_error_give_the_ratio_its_noise() -> None:
    inner, outer = 1 + 0.05 / np.sqrt(2) * np.random.default_rng(3).standard_normal((2, 1_000_000))
    assert np.std(np.log(inner / outer)) == pytest.approx(0.05, rel=0.01)


def test_film_s_charge_counts() -> None:
    scene = read_builtin_scene()
    assert Noise.from_scene(scene) == Noise(charge_per_force=20e-12)
    strong = scene.probe.model_copy(update={"film": Film(d33=-33e-12)})
    assert Noise.from_scene(scene.model_copy(update={"probe": strong})).charge_per_force == 33e-12


def test_without_charge_noise_the_objective_is_detectability_s_and_all_verbs_have_one_noise() -> None:
    """Standard deviation of ln E_object = noise / S, eq. MA.2; defaults are one."""
    assert Thresholds().noise == Noise().ratio == DEFAULT_NOISE
    assert Thresholds().resolved == MAX_RESOLVED_LOG_SD == 0.5
    assert compute_standard_deviation(Noise(charge=0.0).compute_information(0.1, 0.7, 1.0)) == pytest.approx(DEFAULT_NOISE / 0.1)
    for command in ("optimize", "detectability", "estimate"):
        text = re.sub(r"\s+", " ", run(command, "--help").stdout)
        assert f"--noise TEXT Relative standard deviation of one reading of the ratio. [default: {DEFAULT_NOISE:g}]" in text


@pytest.mark.parametrize("command", ["optimize", "detectability", "estimate"])
def test_what_is_no_noise_is_refused_alike(command: str, tmp_path: Path) -> None:
    options = {"optimize": ("-o", f"{tmp_path}/out"), "estimate": ("--ratio", "0.6"), "detectability": ()}[command]
    for noise in ("0", "11", "nan", "-0.1"):
        ended = run(command, SCENE, *options, "--noise", noise)
        assert ended.returncode == 2
        assert "allowed: from 1e-06 to 10: relative" in ended.stderr


def test_noise_is_printed() -> None:
    for arguments in (("detectability", SCENE, "--points", "2", "--accuracy", "0.1"), ("estimate", SCENE, "--ratio", "0.62")):
        assert "noise 2 % on the ratio" in re.sub(r"\s+", " ", run(*arguments, "--noise", "0.02").stdout)
        output = json.loads(run(*arguments, "--noise", "0.02", "--json").stdout)["noise"]
        assert output == (0.02 if arguments[0] == "detectability" else [0.02])


def loaded(load: Load) -> tuple[float, str]:
    """The force on the probe of examples/scene.toml that a load comes to, and what sets it."""
    scene = read_scene(EXAMPLES / "scene.toml").model_copy(update={"load": load})
    pressed = verify_tumour_design(scene, Noise(), "axisymmetric").pressing
    return pressed.force, pressed.limited_by


def test_an_indentation_counts_as_its_force() -> None:
    stiffness = evaluate(read_scene(EXAMPLES / "scene.toml"), "axisymmetric").stiffness
    assert loaded(Load(indentation=1e-6)) == (pytest.approx(1e-6 * stiffness), "scene")
    assert loaded(Load(indentation=2e-6))[0] == pytest.approx(2e-6 * stiffness)
    assert loaded(Load(force=0.001)) == (0.001, "scene")


def test_a_load_beyond_linear_elasticity_is_lowered_to_what_references_allow() -> None:
    """At 1/20 of the load that closes the gap and at a tenth of the radius the ratio is in error by 1 % at most (reference)."""
    reference = json.loads((REFERENCE / "contact" / "expected.json").read_text())["example"]
    scene = read_scene(REFERENCE / "contact" / "example.toml").model_copy(update={"load": Load(force=1.0)})
    totals = evaluate_films(scene, "axisymmetric").films[0].totals
    pressed = compute_pressing(scene, float(totals.sum()), build_load_rule(scene))
    assert pressed.limited_by in ("strain", "gap closure")
    assert pressed.load == Load(force=pressed.force)
    rows = [row for row in reference["rows"] if row["force"] <= 1.4 * pressed.force]  # a little beyond, where the first row is
    assert rows
    for row in rows:
        assert row["ratio"] == pytest.approx(reference["small_load"]["ratio"], rel=0.01)


def test_search_and_verification_press_alike() -> None:
    """With all the rule's limits in turn: the scene's load, the tissue's depth, soft blocks, closure."""
    for scene in (read_builtin_scene(), *(read_scene(REFERENCE / "contact" / f"{name}.toml") for name in ("paper", "example"))):
        for load in (Load(force=1e-6), Load(force=100.0), Load(indentation=1e-3)):
            loaded_scene = scene.model_copy(update={"load": load})
            rough, totals = CoarseModel.from_scene(loaded_scene), np.array([3.0, 5.0])
            closure = float(totals.sum()) * scene.probe.gap / rough.wall_approach
            rule = LoadRule.from_totals(loaded_scene, totals, closure)
            force = compute_pressing(loaded_scene, rule.stiffness, rule).force
            searched = TumourStudy.from_scene(loaded_scene, evaluator="equivalent-inclusion").objective.rule
            rough_force = searched.compute_forces(ProbeSizes.from_scene(scene), totals[None, None], np.zeros(1, dtype=int))
            assert float(rough_force[0, 0]) == pytest.approx(
                force, rel=0.01
            )  # loads that the rule sets are rounded down to three digits


def test_no_load_is_refused() -> None:
    for load in (Load(force=0.0), Load(indentation=0.0)):
        with pytest.raises(InputError, match="above 0"):
            optimize(read_scene(SCENE).model_copy(update={"load": load}))
