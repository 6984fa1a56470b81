"""The command ``load``, as a user runs it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from geometry import read_scene
from probe_design import press
from tests.support.paths import SCENE
from tests.support.program import run

KEYS = {"force", "indentation", "ratio", "log_sensitivity", "stiffness", "closest_walls", "error_estimate"}


@pytest.mark.slow
def test_json_and_picture(tmp_path: Path) -> None:
    picture = tmp_path / "loads.png"
    ended = run("load", SCENE, "--to", "0.04 N", "--points", "2", "--plot", picture, "--json")
    assert ended.returncode == 0
    output = json.loads(ended.stdout)
    assert all(len(output[key]) == 2 for key in KEYS)
    assert output["force"] == pytest.approx([0.02, 0.04], rel=1e-6)
    assert set(output["gap_closure_load"]) == {"force", "indentation", "by", "question", "known"}
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_loads_are_told_by_evaluate_and_plan_too() -> None:
    for command in ("evaluate", "plan"):
        output = json.loads(run(command, SCENE, "--loads", "--json").stdout)
        assert output["gap_closure_load"]["force"] == pytest.approx(0.45, abs=0.03)  # two other codes: 0.45 +- 0.02
        assert output["linear_limit_load"]["force"] == pytest.approx(0.042, rel=0.06)


@pytest.mark.slow
def test_table_and_what_ends(tmp_path: Path) -> None:
    ended = run("load", SCENE, "--to", "0.3 mm", "--points", "1")
    assert ended.returncode == 0
    assert "0.3" in ended.stdout
    assert "log_sensitivity within 5 % of linear elasticity: up to 0.04" in ended.stdout
    assert "the gap stays open: up to 0.4" in ended.stdout


@pytest.mark.slow
def test_off_the_axis_loads_are_as_on_it() -> None:
    scenes = [read_scene(SCENE).replace({"inclusion.x": x}) for x in (0.0, 1e-7)]
    on_axis, beside = (press(scene, force=0.08, points=1) for scene in scenes)
    np.testing.assert_allclose(beside.ratio, on_axis.ratio, rtol=2e-3)
    np.testing.assert_allclose(beside.log_sensitivity, on_axis.log_sensitivity, rtol=0.02)
    np.testing.assert_allclose(beside.force, [0.08], rtol=1e-9)
    limits = beside.load_limits, on_axis.load_limits
    assert limits[0].log_sensitivity.force == pytest.approx(limits[1].log_sensitivity.force, rel=0.12)
    assert any("without tumours" in str(text) for text in beside.warnings)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--to", "3 kPa"), "to = '3 kPa': allowed: a force such as '0.3 N', or an indentation such as '2 mm', above 0"),
        (("--to", "-1 N"), "above 0"),
        (("--to", "0 mm"), "above 0"),
        (("--to", "80 mm"), "less than the tissue's depth"),
        (("--to", "0.1 N", "--accuracy", "2"), "accuracy = '2'"),
        (("--to", "0.1 N", "--plot", "x.doc"), "plot"),
    ],
)
def test_refusals(arguments: tuple[str, ...], words: str) -> None:
    ended = run("load", SCENE, *arguments)
    assert ended.returncode == 2
    assert words in ended.stderr
    assert len(ended.stderr.strip().splitlines()) == 1
