"""Designs that a worker evaluates together: the same rows as alone to within their errors, the same bits in whatever batches."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from geometry import read_scene
from probe_design import sweep
from probe_design.sweeps.file import build_scene, sweep_from_dict
from probe_design.sweeps.results import iterate_rows
from probe_design.sweeps.rows import Job
from solver import evaluate
from tests.support.paths import ROOT, SCENE
from tests.support.sweeps import stored, wait_for_rows

MODULI, GAPS, FORCES = [1e3, 6e3, 1e4, 3e4, 6e4, 2e5, 1e6], [1e-4, 1.3e-4], [1e-4, 1e-3]
COUNT = len(MODULI) * len(GAPS) * len(FORCES)
RUN = "import json, sys; from probe_design import sweep; sweep(json.loads(sys.argv[1]), sys.argv[2], workers=1)"


def make_table(evaluator: str = "axisymmetric", **variables: Any) -> dict[str, Any]:
    """Moduli vary slowest, so that those of one design are far from each other."""
    usual = {"inclusion.youngs_modulus": MODULI, "probe.gap": GAPS, "load.force": FORCES}
    return {"scene": str(SCENE), "evaluator": evaluator, "variables": variables or usual}


def job(specification: dict[str, Any]) -> tuple[Job, list[tuple[Any, ...]]]:
    checked = sweep_from_dict(specification)
    return Job.from_sweep(checked), [values for _, values in checked.list_designs()]


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("groups")
    sweep(make_table(), folder, workers=1)
    return folder


def test_rows_are_what_evaluate_answers_to_within_their_errors(uninterrupted: Path) -> None:
    base = read_scene(SCENE).model_dump(exclude_unset=True)
    keys = job(make_table())[0].keys
    stored = list(iterate_rows(uninterrupted))
    assert [row["number"] for row in stored] == list(range(COUNT))
    for row in stored[::9]:
        scene = build_scene(base, keys, (row["inclusion.youngs_modulus"], row["probe.gap"], row["load.force"]))
        alone = evaluate(scene, "axisymmetric")
        assert alone.ratio is not None
        assert alone.error_estimate is not None
        assert abs(row["ratio"] / alone.ratio - 1) <= row["error_estimate"] + alone.error_estimate <= 0.02
        assert row["stress_inner"] == pytest.approx(alone.stress_inner, rel=0.02)
        assert row["log_sensitivity"] == pytest.approx(alone.log_sensitivity, rel=0.1, abs=2e-5)
        assert (row["evaluator"], json.loads(row["warnings"])) == ("axisymmetric", list(alone.warnings))


@pytest.mark.slow
@pytest.mark.parametrize(("seconds", "workers"), [(1e-9, 2), (1e9, 1)])
def test_no_row_depends_on_batches(
    seconds: float, workers: int, uninterrupted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("probe_design.sweeps.batches.BATCH_TIME_S", seconds)
    assert sweep(make_table(), tmp_path, workers=workers).ok == COUNT
    assert stored(tmp_path) == stored(uninterrupted)


@pytest.mark.slow
def test_killed_between_designs_it_ends_with_the_same_rows(uninterrupted: Path, tmp_path: Path) -> None:
    run = subprocess.Popen([sys.executable, "-c", RUN, json.dumps(make_table()), str(tmp_path)], cwd=ROOT)
    wait_for_rows(tmp_path, 1, run)
    run.kill()
    run.wait()
    count = len(list(iterate_rows(tmp_path)))
    assert count % (len(MODULI) * len(FORCES)) == 0  # a design's moduli and loads are there, or none of them
    assert sweep(make_table(), tmp_path, workers=1).answered == COUNT - count
    assert stored(tmp_path) == stored(uninterrupted)


def test_designs_that_are_refused_are_rows_among_the_others() -> None:
    made, designs = job(make_table("axisymmetric", **{"inclusion.youngs_modulus": [1e3, -1.0, 1e4], "load.force": [1e-3, 1e9]}))
    ((*stored,),) = made.evaluate_parts(designs)
    assert [row["status"] for row in stored] == ["ok", "refused", "refused", "refused", "ok", "refused"]
    assert "youngs_modulus" in stored[2]["reason"]
    assert "deep" in stored[1]["reason"]


def test_what_is_not_answered_together_is_answered_one_by_one() -> None:
    """Of a group under loads that only ``contact`` might take no row waits for the others."""
    made, designs = job(make_table("auto", **{"load.force": [1e-4, 1e-3, 1e9]}) | {"accuracy": 0.05})
    stored = list(made.evaluate_parts(designs))
    assert [len(piece) for piece in stored] == [1, 1, 1]
    assert [piece[0]["status"] for piece in stored] == ["ok", "ok", "refused"]


def test_parts_are_designs_that_differ_in_moduli_and_loads_alone() -> None:
    made, designs = job(make_table())
    assert made.count_parts(designs) == [len(FORCES)] * (len(MODULI) * len(GAPS))
    by_gap = sorted(designs, key=lambda values: values[1])
    assert made.count_parts(by_gap) == [COUNT // 2, COUNT // 2]
    assert job(make_table("equivalent-inclusion"))[0].count_parts(by_gap) == [1] * COUNT
