"""What films answer to about a preload: the tangent response, its sensitivity, and what mixing it with one press costs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from geometry import InputError, Scene
from geometry.scenes.scene_file import scene_to_toml
from probe_design import optimize, scan
from probe_design.built_probe.virtual_probe import compute_load
from solver.contact.evaluator import ContactEvaluator
from solver.evaluation import evaluate
from tests.support.load_paths import COARSE, pressed, ratio, scene_of
from tests.support.program import run

EXAMPLE = scene_of("example")
AREAS = np.array([EXAMPLE.probe.inner_area, EXAMPLE.probe.outer_area])


def preloaded(preload: float, force: float, scene: Scene = EXAMPLE) -> Scene:
    return scene.replace({"load.force": force, "load.preload": preload})


def with_modulus(factor: float) -> Scene:
    return EXAMPLE.replace({"inclusion.youngs_modulus": EXAMPLE.inclusion[0].youngs_modulus * factor})


def tangent_ratio(scene: Scene, force: float) -> float:
    """Ratio of the films' changes between two forces on one mesh, 1 % about the force: no derivative of the program."""
    path = pressed(scene, COARSE)
    change = path.press_to_force(1.01 * force).films - path.press_to_force(0.99 * force).films
    return float(np.divide(*(change / AREAS)))


@pytest.mark.parametrize("name", ["closed-form", "equivalent-inclusion", "axisymmetric"])
def test_linear_evaluators_give_the_change_of_the_force(name: str) -> None:
    whole, part = (evaluate(scene, evaluator=name) for scene in (EXAMPLE.replace({"load.force": 0.03}), preloaded(0.01, 0.03)))
    assert (part.ratio, part.log_sensitivity, part.stiffness) == (whole.ratio, whole.log_sensitivity, whole.stiffness)
    for key in ("stress_inner", "stress_outer"):
        assert getattr(part, key) == pytest.approx(getattr(whole, key) * 2 / 3, rel=1e-12)
    assert "tangent response about a preload of 0.01 N, times 0.02 N" in str(part.response)
    assert whole.response == "one press from zero to the peak"


def test_a_scan_and_a_virtual_probe_give_the_change_of_the_force() -> None:
    scenes = EXAMPLE.replace({"load.force": 0.015}), preloaded(0.005, 0.015)
    whole, part = (scan(scene, positions=[0.0, 2e-3]) for scene in scenes)
    np.testing.assert_allclose(part.stress_inner, 2 / 3 * np.array(whole.stress_inner), rtol=1e-6)  # two solutions
    np.testing.assert_allclose(part.ratio, whole.ratio, rtol=1e-6)
    assert compute_load(preloaded(0.01, 0.03), None) == pytest.approx(0.02)


def test_a_light_preload_is_the_linear_limit() -> None:
    result, linear = (
        ContactEvaluator().evaluate(preloaded(1e-6, 2e-6)),
        evaluate(EXAMPLE, evaluator="axisymmetric", accuracy=1e-3),
    )
    assert result.ratio == pytest.approx(linear.ratio, rel=1e-3)
    assert result.log_sensitivity == pytest.approx(linear.log_sensitivity, rel=0.01)
    assert result.stress_inner == pytest.approx(linear.stress_inner * 1e-6 / EXAMPLE.load.force, rel=1e-3)


@pytest.mark.parametrize("preload", [0.03, 0.06])
def test_contact_gives_the_slope_of_the_load_path_and_its_sensitivity(preload: float) -> None:
    result = ContactEvaluator().evaluate(preloaded(preload, preload + 0.02))
    at_rest = ratio(EXAMPLE, pressed(EXAMPLE, COARSE).points[0])
    expected = tangent_ratio(EXAMPLE, preload) / at_rest  # the mesh's error at rest cancels
    linear = evaluate(EXAMPLE, evaluator="axisymmetric", accuracy=1e-3).ratio
    assert result.ratio == pytest.approx(expected * linear, rel=result.error_estimate)
    step = 0.02
    ends = [np.log(tangent_ratio(with_modulus(float(np.exp(sign * step))), preload)) for sign in (1, -1)]
    assert result.log_sensitivity == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=0.05)
    assert result.stress_inner * AREAS[0] + result.stress_outer * AREAS[1] == pytest.approx(0.02, rel=1e-9)


@pytest.mark.slow
def test_off_the_axis_it_is_as_on_it() -> None:
    """On the axis the tumour is part of the mesh, whose tangent is exact; beside it effects at two forces are differentiated."""
    on_axis, beside = (evaluate(preloaded(0.03, 0.05, EXAMPLE.replace({"inclusion.x": x})), "contact") for x in (0.0, 1e-7))
    press = evaluate(EXAMPLE.replace({"inclusion.x": 1e-7, "load.force": 0.03}), "contact")
    assert beside.ratio == pytest.approx(on_axis.ratio, rel=2e-3)
    assert beside.log_sensitivity == pytest.approx(on_axis.log_sensitivity, rel=0.015)
    assert abs(press.log_sensitivity / on_axis.log_sensitivity - 1) > 0.02  # that of one press is another
    assert beside.stiffness == pytest.approx(on_axis.stiffness, rel=3e-3)
    assert beside.stress_inner * AREAS[0] + beside.stress_outer * AREAS[1] == pytest.approx(0.02, rel=1e-9)


@pytest.mark.slow
def test_a_scan_about_a_preload_of_a_hand_is_by_contact() -> None:
    scanned = scan(preloaded(0.08, 0.1), positions=[4e-3])
    single = evaluate(preloaded(0.08, 0.1, EXAMPLE.replace({"inclusion.x": 4e-3})), "contact")
    assert scanned.evaluator == "contact"
    assert scanned.ratio[0] == pytest.approx(single.ratio, rel=2e-3)
    assert scanned.stress_inner[0] == pytest.approx(single.stress_inner, rel=2e-3)


@pytest.mark.slow
def test_mixing_the_ratio_of_a_press_with_that_about_a_preload_is_a_bias() -> None:
    """A reading about 0.05 N, inverted by the model of one press to 0.05 N on the same mesh: E_object is wrong by 5 to 15 %."""
    force, factors = 0.05, np.exp([-0.3, -0.15, 0.0, 0.15, 0.3])
    presses = [ratio(scene, pressed(scene, COARSE).press_to_force(force)) for scene in map(with_modulus, factors.tolist())]
    read = tangent_ratio(EXAMPLE, force)
    bias = float(np.interp(np.log(read), np.log(presses), np.log(factors)))
    assert 0.05 < bias < 0.15
    small = tangent_ratio(EXAMPLE, 1e-4) / ratio(EXAMPLE, pressed(EXAMPLE, COARSE).press_to_force(1e-4))
    assert abs(np.log(small)) < 2e-5  # under a light load both are the same


def test_auto_takes_the_preload_for_twice_the_press() -> None:
    """A tangent departs from linear elasticity twice as fast as one press: the amplitude does not matter, the preload does."""
    assert evaluate(preloaded(1e-4, 0.03)).evaluator != "contact"
    assert evaluate(preloaded(0.05, 0.0501)).evaluator == "contact"


@pytest.mark.parametrize(
    ("load", "said"),
    [
        ({"load.force": 0.03, "load.preload": 0.03}, r"below load\.force = 0\.03 N"),
        ({"load.force": 0.03, "load.preload": -0.01}, "from 0 N"),
        ({"load.indentation": 1e-4, "load.preload": 0.01}, r"given with load\.force"),
    ],
)
def test_what_is_no_static_part_is_refused(load: dict[str, float], said: str) -> None:
    with pytest.raises((InputError, ValueError), match=said):
        EXAMPLE.replace(load)


def test_a_search_refuses_a_preload(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"load\.preload = 0\.01 N"):
        optimize(preloaded(0.01, 0.02), output=tmp_path)


def test_the_command_prints_which_response_it_is(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(scene_to_toml(preloaded(0.01, 0.03)), encoding="utf-8")
    assert "tangent response about a preload of 0.01 N" in run("evaluate", file, "--evaluator", "axisymmetric").stdout
    output = json.loads(run("evaluate", file, "--evaluator", "axisymmetric", "--json").stdout)
    assert output["response"].startswith("the tangent response")
