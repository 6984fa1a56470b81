"""Loads beyond linear elasticity, given to every command that computes at a scene's load."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.support.paths import SCENE
from tests.support.program import refused, run
from tests.support.slow import slow_unless

COMMAND_LINES = {
    "evaluate": (),
    "curve": ("--points", "3"),
    "scan": ("--points", "3"),
    "detectability": ("--points", "3"),
    "estimate": ("--ratio", "0.563", "--noise", "0.01"),
    "read": ("--virtual", "--seconds", "4"),
    "calibrate": ("--virtual", "-o", "probe.toml"),
    "check": ("--virtual", "--seconds", "4"),
    "tradeoff": ("-o", "out"),
}


@pytest.fixture
def heavy(tmp_path: Path) -> Path:
    """The example at three times what it allows."""
    path = tmp_path / "heavy.toml"
    path.write_text(SCENE.read_text().replace('force = "10 mN"', 'force = "70 mN"'))
    return path


BY_CONTACT = ("evaluate", "curve", "estimate", "scan", "detectability")  # which answers beyond linear elasticity what it can take


@pytest.mark.parametrize("command", ["calibrate", "check", "tradeoff"])
def test_a_load_beyond_contact_is_refused_with_what_is_allowed(
    command: str, heavy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    heavy.write_text(heavy.read_text().replace('"70 mN"', '"5 N"'))
    ended = run(command, heavy, *COMMAND_LINES[command])
    assert ended.returncode == 2
    message = ended.stderr.splitlines()[-1]  # tradeoff's progress comes first
    assert "load.force = 5 N: allowed: " in message
    assert " N " in message.split("allowed: ")[-1]


@pytest.mark.slow
def test_a_virtual_probe_that_is_as_drawn_is_within_tolerance(
    heavy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pins carry the scene's load; without loads in the bench, each block is pressed as far as linear elasticity allows."""
    monkeypatch.chdir(tmp_path)
    assert run("calibrate", heavy, *COMMAND_LINES["calibrate"]).returncode == 0
    checked = json.loads(run("check", heavy, *COMMAND_LINES["check"], "--calibration", "probe.toml", "--json").stdout)
    assert checked["p_value"] > 0.01
    for block in checked["blocks"]:  # the stated uncertainty is seven times as wide: of the probe's moduli and lengths
        assert block["ratio"] == pytest.approx(block["predicted"], rel=0.01)


@pytest.mark.parametrize("command", slow_unless(lambda command: command == "evaluate", BY_CONTACT))
def test_level_contact_answers_it(command: str, heavy: Path) -> None:
    output = json.loads(run(command, heavy, *COMMAND_LINES[command], "--json").stdout)
    assert output["evaluator"] == "contact"
    off_axis = heavy.with_name("beside.toml")
    # 1.2 % is the best there: tissue comes near a wall
    off_axis.write_text(
        heavy.read_text().replace("[[inclusion]]", '[[inclusion]]\nx = "2 mm"') + "\n[reading]\naccuracy = 0.02\n"
    )
    output = json.loads(run(command, off_axis, *COMMAND_LINES[command], "--json").stdout)
    assert output["evaluator"] == "contact"
    off_axis.write_text(off_axis.read_text().replace('"70 mN"', '"0.4 N"'))
    assert "allowed: up to 0.3" in refused(command, off_axis, *COMMAND_LINES[command])


@pytest.mark.parametrize("command", ["evaluate", "curve", "scan", "estimate", "read"])
def test_linear_answers_it_and_counts_the_effect(command: str, heavy: Path) -> None:
    """x is 0.138 at 70 mN, of which the ratio may change by a tenth (``tests/reference/contact`` has a stiffness of 93.2 N/m)."""
    ended = run(command, heavy, *COMMAND_LINES[command], "--linear", "--json")
    assert ended.returncode == 0, ended.stderr
    output = json.loads(ended.stdout)
    if command == "read":
        assert output["predicted_ratio_uncertainty"] > 0.0138 / 3**0.5 * 0.563 * 0.99
        return
    errors = output["error_estimate"]
    assert min(errors) > 0.0125 if isinstance(errors, list) else errors > 0.0137


@pytest.mark.slow
def test_a_sweep_says_which_designs_are_pressed_too_hard(tmp_path: Path) -> None:
    off_axis = tmp_path / "beside.toml"
    off_axis.write_text(SCENE.read_text().replace("[[inclusion]]", '[[inclusion]]\nx = "2 mm"'))
    for name, line, force, counts in (("auto", "", "0.4 N", (1, 1)), ("linear", "linear = true\n", "70 mN", (2, 0))):
        text = f'scene = "{off_axis}"\n{line}[variables."load.force"]\nvalues = ["10 mN", "{force}"]\n'
        (tmp_path / f"{name}.toml").write_text(text)
        output = json.loads(run("sweep", tmp_path / f"{name}.toml", "-o", tmp_path / name, "--json").stdout)
        assert (output["ok"], output["refused"]) == counts
    assert "allowed: up to 0.3" in (tmp_path / "auto" / "results.csv").read_text()
