"""`examples/paper_study.py`: the order of positions, the four scenes, linearity; no mesh is made here."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.image
import pytest

from tests.support.paths import EXAMPLES

sys.path.insert(0, str(EXAMPLES))

import paper_notes
import paper_order
import paper_study
import paper_table

from geometry import BlockTissue, Scene, read_scene
from geometry.common.resources import Limits
from solver import Result, evaluate
from solver.results.warnings import Note

QUICK = "equivalent-inclusion"


def test_order_of_positions() -> None:
    assert paper_order.order(paper_table.get_printed_ratios(signed=False), {}) == "1 < 2 < 3 < 4"
    assert paper_order.order(paper_table.get_printed_ratios(signed=True), {}) == "4 < 1 < 2 < 3"
    ours, bounds = {1: 1.0, 2: 1.1, 3: 2.0, 4: 1.01}, dict.fromkeys(range(1, 5), 0.01)
    assert paper_order.order(ours, bounds) == "1 ~ 4 < 2 < 3"
    pairs = paper_order.agreed(ours, bounds)
    assert pairs == {"alike": ["1 < 2", "1 < 3", "2 < 3"], "otherwise": ["2 < 4", "3 < 4"], "open": ["1 < 4"]}


@pytest.fixture
def study() -> Scene:
    return read_scene(paper_study.SCENE)


def test_four_scenes_of_the_study(study: Scene) -> None:
    assert isinstance(study.tissue, BlockTissue)
    assert (study.tissue.length, study.tissue.breadth, study.tissue.depth) == pytest.approx((0.1, 0.08, 0.06))
    assert [body.diameter for body in study.inclusion] == pytest.approx([0.008, 0.005])
    assert study.probe.inner_area / study.probe.outer_area == pytest.approx(paper_table.AREA_RATIO)
    scenes = paper_study.scenes(study)
    assert list(scenes) == list(paper_table.POSITION_NAMES) == list(paper_table.TABLE_3)
    for k, scene in scenes.items():
        assert Scene.model_validate(scene.model_dump()) == scene
        nearest = min(abs(body.x - scene.placement.x) for body in scene.inclusion)
        assert nearest == pytest.approx({1: 0.015, 2: 0.0, 3: 0.0, 4: 0.025}[k], abs=1e-12)


def test_one_solution_serves_three_loads(study: Scene) -> None:
    """Solutions at one load and ten times that are as far apart as the table takes them to be."""
    scene_at = paper_study.scenes(study)[3]
    pressed = [scene_at.model_copy(update={"load": scene_at.load.model_copy(update={"force": f})}) for f in (1e-4, 1e-3)]
    small, ten = (paper_study.at_one_newton(evaluate(scene, QUICK, 0.05), scene) for scene in pressed)
    assert paper_study.loaded(small, 10.0) == pytest.approx(paper_study.loaded(ten, 10.0), rel=1e-9)
    assert small.stress_inner is not None
    assert small.stress_outer is not None
    total = small.stress_inner * scene_at.probe.inner_area + small.stress_outer * scene_at.probe.outer_area
    assert total == pytest.approx(1.0, rel=1e-9)


def test_each_position_is_solved_once(study: Scene, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    seen: list[Scene] = []

    def solved(scene: Scene, name: str, accuracy: float, progress: Any, *, limits: Limits) -> Result:
        assert limits.seconds > Limits().seconds
        seen.append(scene)
        progress("meshing")
        return Result(name, 1.0, 12e3 * 1e-4, 0.5e3 * 1e-4, 24.0, 1e-3, 13.0, error_estimate=0.004)

    monkeypatch.setattr(paper_study, "evaluate", solved)
    assert paper_study.main(["--json"]) == 0
    output, err = capsys.readouterr()
    assert seen == list(paper_study.scenes(study).values())
    assert [row["stress_inner"] for row in json.loads(output)["positions"][3]["ours"]] == pytest.approx([12e3, 60e3, 120e3])
    assert "position 4 of 4: meshing" in err


def test_notes_without_a_ratio() -> None:
    results = dict.fromkeys(range(1, 5), Result(QUICK, 0.0))
    assert any("ours unknown" in line for line in paper_notes.notes(results))
    assert paper_study.loaded(replace(results[1], ratio=2.0), 5.0) == (None, None, 2.0, None)


def run(*arguments: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "error", str(EXAMPLES / "paper_study.py"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, cwd=cwd, timeout=250)


@pytest.mark.slow
def test_as_a_user_runs_it(tmp_path: Path) -> None:
    ended = run("--evaluator", QUICK, "--accuracy", "0.05", "--json", "--plot", "study.png", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    output = json.loads(ended.stdout)
    assert [position["position"] for position in output["positions"]] == [1, 2, 3, 4]
    for position in output["positions"]:
        assert [row["ratio"] for row in position["ours"]] == [position["result"]["ratio"]] * 3
        assert position["ours"][2]["stress_inner"] == pytest.approx(10 * position["result"]["stress_inner"])
    ratio = [position["result"]["ratio"] for position in output["positions"]]
    assert ratio[0] < ratio[1] < ratio[2]
    assert ratio[3] == pytest.approx(ratio[0], rel=0.005)
    assert matplotlib.image.imread(tmp_path / "study.png").shape[0] > 400


def test_tables_and_refusal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    result = Result(
        "solid", 1.0, 12.59e3, 0.5157e3, 24.42, 1e-3, 13.0, error_estimate=0.004, warnings=(Note("accuracy", "a warning"),)
    )
    monkeypatch.setattr(paper_study, "solved", lambda *_: dict.fromkeys(range(1, 5), result))
    assert paper_study.main([]) == 0
    output, _ = capsys.readouterr()
    for text in ("26.59134", "0.2578", "-, printed as +", "125.9", "Can be compared, linearity", "Cannot be compared, loads"):
        assert text in output
    assert output.count("solid: a warning") == 1
    assert paper_study.main(["--plot", "study.xyz"]) == 2
    output, err = capsys.readouterr()
    assert output == ""
    assert err.count("\n") == 1
