"""One number for one question: up to which load linear elasticity holds, whichever command is asked."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from geometry import Scene, read_scene
from geometry.scenes.scene_file import scene_to_toml
from geometry.scenes.scene_tables import Load
from probe_design.design_search.tumour_objective import Noise
from probe_design.design_search.verification import verify_tumour_design
from solver import evaluate, plan, press
from solver.contact.load_curve import find_load_ends
from tests.support.paths import EXAMPLES, REFERENCE
from tests.support.program import run

FORCE = Load(force=1e-4)  # that every command takes without --linear
KEYS = ("linear_limit_load", "gap_closure_load", "load_limits")
MAPS: dict[str, tuple[str, ...]] = {
    "curve": ("--from", "10 kPa", "--to", "100 kPa", "--points", "2"),
    "scan": ("--from", "-2 mm", "--to", "2 mm", "--points", "2"),
    "detectability": ("--points", "2", "--accuracy", "0.01"),
}


def example(**inclusion: Any) -> Scene:
    scene = read_scene(EXAMPLES / "scene.toml")
    body = scene.inclusion[0].model_copy(update=inclusion)
    return scene.model_copy(update={"inclusion": (body,), "load": FORCE})


def grooved() -> Scene:
    return read_scene(REFERENCE / "solid" / "groove-on-axis.toml").model_copy(update={"load": Load(force=1e-6)})


def scenes() -> dict[str, Scene]:
    return {
        "on the axis": example(),
        "off the axis": example(x=3e-3),
        "a soft tumour": example(youngs_modulus=500.0),
        "layers": read_scene(EXAMPLES / "skin.toml").model_copy(update={"load": FORCE}),
        "soft blocks": read_scene(REFERENCE / "contact" / "paper.toml").model_copy(update={"load": Load(force=1e-5)}),
        "two tumours": read_scene(EXAMPLES / "two-tumours.toml").model_copy(update={"load": FORCE}),
    }


def run_json(*words: str | Path) -> dict[str, Any]:
    ended = run(*words, "--json")
    assert ended.returncode == 0, ended.stderr
    output = json.loads(ended.stdout)
    return {key: output[key] for key in KEYS}


@pytest.mark.slow
@pytest.mark.parametrize("name", scenes())
def test_every_command_says_the_same(name: str, tmp_path: Path) -> None:
    scene, path = scenes()[name], tmp_path / "scene.toml"
    path.write_text(scene_to_toml(scene))
    expected = run_json("plan", path)
    assert expected["linear_limit_load"]["known"] == "bound"
    assert expected["linear_limit_load"]["question"] in (entry["question"] for entry in expected["load_limits"].values() if entry)
    commands = [("evaluate",), ("evaluate", "--linear"), ("evaluate", "--evaluator", "equivalent-inclusion")]
    commands += [("evaluate", "--evaluator", "closed-form")] if name != "layers" else []
    for command, *options in commands:
        assert run_json(command, path, *options) == expected, (command, options)
    if scene.target is not None:
        for command, words in MAPS.items():
            assert run_json(command, path, *words) == expected, command


def test_a_groove_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(scene_to_toml(grooved()))
    assert run_json("plan", path) == run_json("evaluate", path, "--evaluator", "axisymmetric")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["on the axis", "off the axis", "soft blocks"])
def test_an_optimisation_presses_as_far_as_the_ratio_holds_to_one_percent(name: str) -> None:
    scene = scenes()[name].model_copy(update={"load": Load(force=10.0)})
    limits = plan(scene).load_limits
    assert limits.ratio is not None
    assert limits.gap_closure is not None
    judge = "equivalent-inclusion" if name == "off the axis" else "axisymmetric"
    pressed = verify_tumour_design(scene, Noise.from_scene(scene), judge).pressing
    assert pressed.force == pytest.approx(min(limits.ratio.force, limits.gap_closure.force), rel=0.01)  # of three digits
    assert pressed.force <= limits.ratio.force


@pytest.mark.parametrize("name", ["on the axis", "soft blocks"])
def test_finite_strain_changes_no_more_than_the_bounds_say(name: str) -> None:
    """``contact`` pressed to each bound: the ratio is in error by the accuracy at most, the log-sensitivity by five."""
    scene = scenes()[name]
    limits, still = plan(scene).load_limits, evaluate(scene, "axisymmetric", 1e-3)
    assert limits.ratio is not None
    assert limits.log_sensitivity is not None
    assert limits.gap_closure is not None
    for limit, key, allowed in ((limits.ratio, "ratio", 0.01), (limits.log_sensitivity, "log_sensitivity", 0.05)):
        lower_limit = limit if limit.force < limits.gap_closure.force else limits.gap_closure
        pressed = evaluate(scene.model_copy(update={"load": Load(force=lower_limit.force)}), "contact", 2e-3)
        assert abs(getattr(pressed, key) / getattr(still, key) - 1) <= allowed


@pytest.mark.slow
def test_computed_loads_are_those_of_the_load_curve(tmp_path: Path) -> None:
    """Whatever loads are requested; pressed there, the log-sensitivity is in error by what was requested."""
    scene = example()
    path = tmp_path / "scene.toml"
    path.write_text(scene_to_toml(scene))
    expected = run_json("plan", path, "--loads")
    assert run_json("load", path, "--to", "0.02 N", "--points", "1") == expected
    assert run_json("load", path, "--to", "0.1 N", "--points", "2") == expected
    assert run_json("evaluate", path, "--loads") == expected
    limits, bounds = plan(scene, loads=True).load_limits, plan(scene).load_limits
    assert limits.log_sensitivity is not None
    assert limits.log_sensitivity.known == "contact"
    assert limits.linear == limits.log_sensitivity
    pressed = press(scene, force=limits.log_sensitivity.force, points=1)
    still = evaluate(scene, "axisymmetric", 1e-3).log_sensitivity
    assert still is not None
    assert pressed.log_sensitivity[-1] == pytest.approx(1.05 * still, abs=0.005 * still)
    assert limits.gap_closure is not None
    assert limits.gap_closure.force == pytest.approx(0.45, abs=0.03)  # two other codes: 0.45 +- 0.02
    for name in ("ratio", "log_sensitivity", "gap_closure"):
        assert getattr(bounds, name).force < getattr(limits, name).force, name


def test_where_contact_finds_nothing_it_says_so() -> None:
    """Within 90 % no load that is reached is too large: the limits are null and a line says how far is known."""
    scene = read_scene(REFERENCE / "contact" / "paper.toml")
    limits = find_load_ends(scene, 0.9)
    assert limits.ratio is None
    assert any("stays within 90 % of linear elasticity up to" in note for note in limits.notes)


@pytest.mark.parametrize("name", ["on the axis", "soft blocks", "layers"])
def test_an_indentation_is_the_one_of_the_probe(name: str) -> None:
    """The share of the outer radius in a plan's line is that of the indentation, by an evaluator's own stiffness."""
    scene = scenes()[name]
    stiffness = evaluate(scene, "axisymmetric").stiffness
    assert stiffness is not None
    (line,) = (decision.reason for decision in plan(scene).decisions if decision.feature == "finite strain")
    share = float(line.split(" mm, ")[1].split(" % of the outer radius")[0]) / 100
    assert share == pytest.approx((scene.load.force or 0.0) / stiffness / scene.probe.tube_radius, rel=0.15)
