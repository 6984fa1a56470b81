"""Rows of sweeps: results of evaluate, refusals and faults with their reasons, nothing twice."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from geometry import InputError, read_scene
from geometry.processes.executor import ExecutorError
from probe_design import sweep
from probe_design.sweeps.file import sweep_from_dict
from probe_design.sweeps.results import iterate_rows
from probe_design.sweeps.rows import Job, compute_version
from probe_design.sweeps.store import open_for_writing
from solver import evaluate
from tests.support.paths import SCENE
from tests.support.sweeps import grid, stored


class TestRows:
    def test_rows_are_what_evaluate_answers(self, tmp_path: Path) -> None:
        results = sweep(grid(2, 2), tmp_path, workers=1)
        assert (results.designs, results.ok, results.answered) == (4, 4, 4)
        last = list(iterate_rows(tmp_path))[-1]
        scene = read_scene(SCENE).model_dump(exclude_unset=True)
        scene["probe"]["gap"], scene["inclusion"][0]["depth"] = 2e-4, 0.012
        alone = evaluate(type(read_scene(SCENE)).model_validate(scene), "closed-form")
        assert (last["probe.gap"], last["inclusion.depth"]) == (2e-4, 0.012)
        assert all(last[name] == getattr(alone, name) for name in ("ratio", "stress_inner", "stiffness", "error_estimate"))
        assert json.loads(last["warnings"]) == list(alone.warnings)

    def test_refused_designs_are_rows_with_a_reason(self, whole: Path) -> None:
        refused = [row for row in iterate_rows(whole) if row["status"] == "refused"]
        buried = [row for row in iterate_rows(whole) if row["inclusion[0].depth"] < 0.004]  # would stick out of the tissue
        assert buried
        assert {row["number"] for row in buried} <= {row["number"] for row in refused}
        assert all("inclusion" in row["reason"] and row["type"] and row["ratio"] is None for row in refused)
        assert len(list(iterate_rows(whole))) == 300

    def test_a_fault_of_the_program_is_a_row(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def broken(*_: object, **__: object) -> None:
            raise ZeroDivisionError("by\nzero")

        monkeypatch.setattr("probe_design.sweeps.rows.evaluate", broken)
        job = Job.from_sweep(sweep_from_dict(grid(2, 2) | {"evaluator": "axisymmetric"}))
        ((row,),) = job.evaluate_parts([(1e-4, 0.009)])
        assert (row["status"], row["type"], row["reason"]) == ("failed", "ZeroDivisionError", "by zero")

    def test_another_version_answers_nothing(self) -> None:
        job = Job.from_sweep(sweep_from_dict(grid(2, 2)))
        with pytest.raises(InputError, match="version"):
            replace(job, version="0").warm_up()

    def test_other_sources_or_data_are_another_version(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        monkeypatch.setattr("probe_design.sweeps.rows.SOURCE_ROOT", tmp_path)
        keys = set()
        for name in ("geometry/a.py", "solver/room/b.py", "solver/room/weights.json"):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text("1")
            keys.add(compute_version.__wrapped__())
        assert len(keys) == 3

    def test_another_mesher_is_another_version(self, monkeypatch: pytest.MonkeyPatch) -> None:
        function = "probe_design.sweeps.rows.find_version"
        keys = set()
        for number in ("0.4.2", "0.4.3"):
            monkeypatch.setattr(function, lambda name, number=number: number if name == "pytetwild" else "1")
            keys.add(compute_version.__wrapped__())
        assert len(keys) == 2

    def test_starting_again_repeats_no_row_and_a_larger_grid_keeps_those_there(self, tmp_path: Path) -> None:
        assert sweep(grid(2, 2), tmp_path, workers=1).answered == 4
        seconds = [row["seconds"] for row in iterate_rows(tmp_path)]
        assert sweep(grid(2, 2), tmp_path, workers=1).answered == 0
        assert [row["seconds"] for row in iterate_rows(tmp_path)] == seconds
        assert sweep(grid(3, 2), tmp_path, workers=1).answered == 2  # the middle gap
        assert len(list(iterate_rows(tmp_path))) == 6

    @pytest.mark.slow
    @pytest.mark.parametrize("evaluator", ["axisymmetric", "equivalent-inclusion"])
    def test_no_row_depends_on_those_before(self, evaluator: str, tmp_path: Path) -> None:
        """Solvers keep factors and analyses from design to design; the last bits, the residual's too, are the same."""

        def make_table(gaps: list[float]) -> dict[str, Any]:
            return {"scene": SCENE, "evaluator": evaluator, "variables": {"probe.gap": gaps}}

        gaps = [5e-5, 1e-4]
        for some_gaps in (gaps[1:], gaps):
            sweep(make_table(some_gaps), tmp_path / "parts", workers=1)
        sweep(make_table(gaps), tmp_path / "whole", workers=1)
        assert stored(tmp_path / "parts") == stored(tmp_path / "whole")
        assert all(0 < row["residual"] < 1e-15 for row in iterate_rows(tmp_path / "whole"))

    def test_another_version_answers_all_anew_and_keeps_what_was_there(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        assert sweep(grid(2, 2), tmp_path, workers=1).answered == 4
        monkeypatch.setattr("probe_design.sweeps.rows.compute_version", lambda: "0")
        with pytest.raises(ExecutorError, match="version"):  # its workers are of the old one
            sweep(grid(2, 2), tmp_path, workers=1)
        assert list(iterate_rows(tmp_path)) == []
        monkeypatch.undo()
        assert sweep(grid(2, 2), tmp_path, workers=1).answered == 0

    def test_a_store_of_another_format_is_refused(self, tmp_path: Path) -> None:
        with open_for_writing(tmp_path) as store:
            store._connection.execute("PRAGMA user_version = 1")
        with pytest.raises(InputError, match="format 5, not 1"):
            sweep(grid(2, 2), tmp_path)
        with pytest.raises(InputError, match="format 5, not 1"):
            list(iterate_rows(tmp_path))

    def test_surface_files_count_by_what_they_hold(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def key() -> bytes:
            made_sweep = sweep_from_dict(
                {"scene": "scene.toml", "variables": {"probe.gap": [1e-4]}}, Path(os.path.relpath(tmp_path))
            )
            return Job.from_sweep(made_sweep).compute_digest(made_sweep.keys, made_sweep.list_designs()[0][1])

        text = SCENE.read_text().replace('diameter = "8 mm"', 'surface = "tumour.stl"')
        (tmp_path / "scene.toml").write_text(text)
        (tmp_path / "tumour.stl").write_text("solid a")
        keys = [key()]
        monkeypatch.chdir(tmp_path)
        keys.append(key())
        (tmp_path / "tumour.stl").write_text("solid of another size")
        keys.append(key())
        (tmp_path / "tumour.stl").unlink()
        keys.append(key())
        assert keys[0] == keys[1]
        assert len(set(keys)) == 3

    @pytest.mark.slow
    def test_designs_that_are_the_same_are_answered_once(self, tmp_path: Path) -> None:
        results = sweep({"scene": SCENE, "evaluator": "closed-form", "variables": {"probe.gap": [1e-4, 1e-4, 2e-4]}}, tmp_path)
        assert (results.answered, results.ok) == (2, 3)


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")])
def test_a_surface_that_is_a_pipe_or_a_device_is_a_refused_row(tmp_path: Path, make: Callable[[Path], None]) -> None:
    make(tmp_path / "it.stl")
    scene = read_scene(SCENE)
    body = scene.inclusion[0].model_copy(update={"diameter": None, "surface": str(tmp_path / "it.stl")})
    table = grid(1, 1) | {"scene": scene.model_copy(update={"inclusion": (body,)}), "variables": {"probe.gap": [1e-4]}}
    job = Job.from_sweep(sweep_from_dict(table))
    assert job.compute_digest(job.keys, (1e-4,)) != job.compute_digest(job.keys, (2e-4,))
    ((row,),) = job.evaluate_parts([(1e-4,)])
    assert row["status"] == "refused"
