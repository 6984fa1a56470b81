"""Limits of time and memory of each design: handed to workers, reported in rows, and evaluated again where they are raised."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from geometry import InputError
from geometry.common.resources import Limits, use_limits
from probe_design import sweep
from probe_design.sweeps.file import sweep_from_dict
from probe_design.sweeps.results import iterate_rows
from probe_design.sweeps.rows import Job
from solver import Result
from solver.results.warnings import Kind, Note
from tests.support.sweeps import grid, run, toml

ASKED = grid(2, 2) | {"evaluator": "axisymmetric", "variables": {"probe.gap": [1e-4]}}


@pytest.mark.slow
def test_what_a_limit_stopped_is_answered_anew_with_a_larger_one(tmp_path: Path) -> None:
    small = ASKED | {"memory_limit": 1e8}
    assert sweep(small, tmp_path, workers=1).refused == 1
    (row,) = iterate_rows(tmp_path)
    assert (row["type"], row["time_limit"], row["memory_limit"]) == ("LimitReached", None, 1e8)
    assert "memory = 0.1 GB: allowed: " in row["reason"]
    assert sweep(small | {"time_limit": 7200.0}, tmp_path, workers=1).answered == 0  # more time is no help
    assert sweep(ASKED, tmp_path, workers=1).ok == 1


def test_rows_say_which_limit_stopped_them() -> None:
    job = Job.from_sweep(sweep_from_dict(ASKED))
    with use_limits(Limits(seconds=1e-9)):  # over before it begins, however warm the process
        ((row,),) = job.evaluate_parts([(1e-4,)])
    assert (row["status"], row["type"]) == ("refused", "LimitReached")
    assert (row["time_limit"], row["memory_limit"]) == (1e-9, None)
    ((row,),) = job.evaluate_parts([(-1.0,)])  # no such gap, however much time there is
    assert (row["status"], row["time_limit"], row["memory_limit"]) == ("refused", None, None)


def test_an_accuracy_that_a_limit_forbids_names_both(monkeypatch: pytest.MonkeyPatch) -> None:
    from solver.results.evaluator import OutOfReach

    def stopped(scene: object, **_: object) -> None:
        raise OutOfReach("axisymmetric", scene, 1e-4, 1e-3, stopped="no finer mesh")  # type: ignore[arg-type]

    monkeypatch.setattr("probe_design.sweeps.rows.evaluate", stopped)
    with use_limits(Limits(memory=3e9, seconds=60.0)):
        ((row,),) = Job.from_sweep(sweep_from_dict(ASKED)).evaluate_parts([(1e-4,)])
    assert (row["time_limit"], row["memory_limit"]) == (60.0, 3e9)


@pytest.mark.parametrize(("kind", "named"), [("limit", (60.0, 3e9)), ("accuracy", (None, None))])
def test_an_answer_that_a_limit_kept_from_a_finer_mesh_names_both(
    monkeypatch: pytest.MonkeyPatch, kind: Kind, named: object
) -> None:
    rough = Result("solid", 1.0, ratio=0.5, error_estimate=0.05, warnings=(Note(kind, "no third mesh"),))
    monkeypatch.setattr("probe_design.sweeps.rows.evaluate", lambda scene, **_: rough)
    with use_limits(Limits(memory=3e9, seconds=60.0)):
        ((row,),) = Job.from_sweep(sweep_from_dict(ASKED)).evaluate_parts([(1e-4,)])
    assert (row["status"], row["ratio"]) == ("ok", 0.5)
    assert (row["time_limit"], row["memory_limit"]) == named


@pytest.mark.slow
def test_a_rough_answer_is_answered_anew_where_the_limit_that_stopped_it_is_raised(tmp_path: Path) -> None:
    fine = ASKED | {"accuracy": 1e-5}
    assert sweep(fine | {"memory_limit": 4.5e8}, tmp_path, workers=1).ok == 1
    (rough,) = iterate_rows(tmp_path)
    assert rough["error_estimate"] > 1e-5
    assert sweep(fine | {"memory_limit": 4e8}, tmp_path, workers=1).answered == 0  # less is no help
    assert sweep(fine, tmp_path, workers=1).answered == 1
    (better,) = iterate_rows(tmp_path)
    assert better["error_estimate"] < 1e-5
    assert abs(rough["ratio"] / better["ratio"] - 1) < rough["error_estimate"] + better["error_estimate"]
    assert sweep(fine, tmp_path, workers=1).answered == 0


def test_a_sweep_has_the_limits_that_it_says_and_else_those_that_hold() -> None:
    with use_limits(Limits(memory=5e9, seconds=50.0)):
        assert sweep_from_dict(ASKED).limits == Limits(memory=5e9, seconds=50.0)
        made_sweep = sweep_from_dict(ASKED | {"time_limit": "2 min", "memory_limit": "500 MB"})
    assert made_sweep.limits == Limits(memory=5e8, seconds=120.0)
    with pytest.raises(InputError, match="memory_limit = 5000: allowed: a memory with its unit"):
        sweep_from_dict(ASKED | {"memory_limit": 5000, "variables": {"probe.gap": ["0.1 mm"]}}, units_required=True)


@pytest.mark.slow
def test_the_options_come_before_the_file(tmp_path: Path) -> None:
    path = toml(tmp_path, 'memory_limit = "5 GB"', n=2)
    path.write_text(path.read_text().replace('"closed-form"', '"axisymmetric"').replace('"3.5 mm"', '"6 mm"'))
    stopped = run(path, "-o", tmp_path / "out", "--memory", "100 MB", "--json")
    assert json.loads(stopped.stdout)["refused"] == 2
    with (tmp_path / "out" / "results.csv").open(encoding="utf-8", newline="") as file:
        assert {row["memory_limit, byte"] for row in csv.DictReader(file)} == {"100000000.0"}
    assert json.loads(run(path, "-o", tmp_path / "out", "--time", "1 h", "--json").stdout)["ok"] == 2
    wrong = run(path, "-o", tmp_path / "out", "--time", "5")
    assert (wrong.returncode, wrong.stderr.count("\n")) == (2, 1)
    assert wrong.stderr.startswith("probe-design: time = '5'")
