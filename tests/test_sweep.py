"""Sweeps: what is asked, what is kept through kills, full disks and lost workers, and what comes out."""

from __future__ import annotations

import csv
import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from geometry import InputError, read_scene
from geometry.errors import MissingLibrary
from probe_design import sweep
from probe_design.sweep_constraints import kept
from probe_design.sweep_crew import CrewError
from probe_design.sweep_effects import main_effect, sobol_indices
from probe_design.sweep_file import read_sweep, scene_of, sweep_from_dict
from probe_design.sweep_process import WorkerProcess
from probe_design.sweep_results import dataframe, dataset, rows, to_csv, to_parquet
from probe_design.sweep_rows import COLUMNS, Job
from probe_design.sweep_samples import Sample
from probe_design.sweep_store import reading, writing
from solver import evaluate

ROOT = Path(__file__).parents[1]
SCENE = ROOT / "examples" / "scene.toml"
GAP = {"from": "0.05 mm", "to": "0.2 mm"}
DEPTH = {"from": "6 mm", "to": "12 mm"}


def grid(gaps: int, depths: int) -> dict[str, Any]:
    variables = {"probe.gap": GAP | {"points": gaps}, "inclusion.depth": DEPTH | {"points": depths}}
    return {"scene": str(SCENE), "evaluator": "closed-form", "variables": variables}


def toml(folder: Path, text: str = "", n: int = 300) -> Path:
    """A sweep file of ``n`` cheap designs."""
    path = folder / "sweep.toml"
    path.write_text(
        f'scene = {json.dumps(str(SCENE))}\nevaluator = "closed-form"\n{text}\n[sample]\n'
        f'kind = "latin-hypercube"\nn = {n}\nseed = 3\n'
        '[variables."probe.gap"]\nfrom = "0.05 mm"\nto = "0.2 mm"\nscale = "log"\n'
        '[variables."inclusion[0].depth"]\nfrom = "3.5 mm"\nto = "12 mm"\n'  # the tumour's radius is 4 mm: some are refused
    )
    return path


def command(*arguments: str | Path) -> list[str]:
    return [sys.executable, "-W", "error", "-m", "probe_design", "sweep", *map(str, arguments)]


def run(*arguments: str | Path, **more: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(*arguments), capture_output=True, text=True, stdin=subprocess.DEVNULL, cwd=ROOT, timeout=100, **more
    )


def stored(folder: Path) -> list[tuple[Any, ...]]:
    """Every column of every row but the times."""
    with reading(folder) as store:
        return [
            (number, inputs, key, *(row[name] for name in COLUMNS if name != "seconds"))
            for number, inputs, key, row in store.rows()
        ]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An uninterrupted sweep of 300 designs on one worker."""
    folder = tmp_path_factory.mktemp("whole")
    sweep(toml(folder), folder / "out", workers=1)
    return folder / "out"


class TestFile:
    def test_a_grid_has_every_combination_the_last_changing_fastest(self) -> None:
        asked = sweep_from_dict(grid(3, 2))
        assert [values for _, values in asked.designs()] == [(g, d) for g in (5e-5, 1.25e-4, 2e-4) for d in (0.006, 0.012)]

    def test_values_reach_the_scene(self) -> None:
        changes = {"inclusion[0].depth": ["11 mm"], "probe.outer_radius": ["8 mm"], "contact.interface": ["frictionless"],
                   "load.indentation": ["3 um"]}  # fmt: skip
        asked = sweep_from_dict({"scene": SCENE, "variables": changes})
        scene = scene_of(asked.base, asked.keys, asked.designs()[0][1])
        assert (scene.inclusion[0].depth, scene.probe.outer_radius, scene.probe.area_ratio) == (0.011, 0.008, None)
        assert (scene.contact.interface, scene.load.force, scene.load.indentation) == ("frictionless", None, 3e-6)

    @pytest.mark.parametrize("kind", ["sobol", "latin-hypercube", "saltelli"])
    def test_samples_are_in_range_and_the_same_every_time(self, kind: str) -> None:
        variables = {
            "probe.gap": GAP | {"scale": "log"},
            "inclusion.depth": DEPTH,
            "contact.interface": ["bonded", "frictionless"],
        }
        asked = sweep_from_dict({"scene": SCENE, "sample": {"kind": kind, "n": 64, "seed": 5}, "variables": variables})
        designs = asked.designs()
        assert designs == asked.designs()
        assert len(designs) == (64 * 5 if kind == "saltelli" else 64)
        gaps, depths, kinds = zip(*(values for _, values in designs), strict=True)
        assert 5e-5 <= min(gaps) < 5.5e-5
        assert np.mean(np.log(gaps)) == pytest.approx(np.log(1e-4), abs=0.05)  # geometric mean of the range
        assert np.mean(depths) == pytest.approx(0.009, rel=0.02)
        assert 0.4 < kinds.count("bonded") / len(kinds) < 0.6

    def test_a_saltelli_sample_is_what_salib_expects(self) -> None:
        """Sobol indices of the Ishigami function: Saltelli et al., Global Sensitivity Analysis (2008), section 4.5."""
        u = np.array(Sample("saltelli", 4096, 1)._shares(3))
        x = np.pi * (2 * u - 1)
        y = np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
        found = sobol_indices(y, 3)
        for (first, first_off, total, total_off), known in zip(
            found, ((0.3139, 0.5576), (0.4424, 0.4424), (0.0, 0.2437)), strict=True
        ):
            assert abs(first - known[0]) < max(1.5 * first_off, 0.005)
            assert abs(total - known[1]) < max(1.5 * total_off, 0.005)
            assert max(first_off, total_off) < 0.1

    @pytest.mark.parametrize(
        ("text", "kept_ones"),
        [
            ("probe.gap < 0.025 * probe.inner_radius", [1, 1, 0]),  # of 4 mm
            ("'0.1 mm' <= probe.gap < '0.2 mm'", [0, 1, 0]),
            ("probe.gap < '0.1 mm' or not probe.gap < 2e-4", [1, 0, 1]),
            ("(probe.gap / 1e-4) ** 2 - 1 >= 0 and probe.gap != 1e-4", [0, 0, 1]),
        ],
    )
    def test_constraints(self, text: str, kept_ones: list[int]) -> None:
        asked = sweep_from_dict({"scene": SCENE, "variables": {"probe.gap": [5e-5, 0.99e-4 if "inner" in text else 1e-4, 2e-4]},
                                 "constraints": [text]})  # fmt: skip
        assert [number for number, _ in asked.designs()] == [place for place, one in enumerate(kept_ones) if one]

    @pytest.mark.parametrize(
        "text",
        ["__import__('os').system('true')", "probe.gap", "probe.gap < 'red'", "probe.gup < 1", "[1] < [2]", "probe.gap < 1 / 0",
         "(lambda: 1)() < 2", "probe.gap <", "10.0 ** 10.0 ** 10.0 > 1", "contact.interface < 1",
         "1 < " + "(" * 300 + "1" + ")" * 300],
    )  # fmt: skip
    def test_what_is_no_condition_is_refused(self, text: str) -> None:
        asked = sweep_from_dict({"scene": SCENE, "variables": {"probe.gap": [1e-4]}, "constraints": [text]})
        with pytest.raises(InputError, match=r"constraints|variable"):
            asked.designs()

    def test_each_side_is_read_once(self) -> None:
        assert kept("a.b > 1 and a.b < 3", lambda name: np.array([1.0, 2.0, 3.0]), 3).tolist() == [False, True, False]

    @pytest.mark.parametrize(
        ("old", "new", "word"),
        [
            ("evaluator", "evaluater", "evaluater"),
            ('"closed-form"', '"magic"', "evaluator"),
            ("probe.gap", "probe.gup", "gup"),
            ("inclusion[0]", "inclusion[1]", "inclusion[1]"),
            ('"0.05 mm"', "0.05", "unit is missing"),
            ('"0.05 mm"', '"0.05 Pa"', "probe.gap.from"),
            ('"0.05 mm"', '"5 mm"', "probe.gap.to"),
            ('"log"', '"cubic"', "scale"),
            ('"latin-hypercube"', '"random"', "sample.kind"),
            ("n = 300", "n = 0", "sample.n"),
            ("seed", "speed", "sample.speed"),
            ("scene.toml", "absent.toml", "absent.toml"),
            ("[sample]", "[sample", "sweep.toml"),
        ],
    )
    def test_refusals_name_the_key(self, old: str, new: str, word: str, tmp_path: Path) -> None:
        path = toml(tmp_path)
        path.write_text(path.read_text().replace(old, new, 1))
        with pytest.raises(InputError) as refused:
            read_sweep(path)
        assert word in str(refused.value)


class TestRows:
    def test_rows_are_what_evaluate_answers(self, tmp_path: Path) -> None:
        found = sweep(grid(2, 2), tmp_path, workers=1)
        assert (found.designs, found.ok, found.answered) == (4, 4, 4)
        last = list(rows(tmp_path))[-1]
        scene = read_scene(SCENE).model_dump(exclude_unset=True)
        scene["probe"]["gap"], scene["inclusion"][0]["depth"] = 2e-4, 0.012
        alone = evaluate(type(read_scene(SCENE)).model_validate(scene), "closed-form")
        assert (last["probe.gap"], last["inclusion.depth"]) == (2e-4, 0.012)
        assert all(last[name] == getattr(alone, name) for name in ("ratio", "stress_inner", "stiffness", "error_estimate"))
        assert json.loads(last["warnings"]) == list(alone.warnings)

    def test_refused_designs_are_rows_with_a_reason(self, whole: Path) -> None:
        refused = [row for row in rows(whole) if row["status"] == "refused"]
        buried = [row for row in rows(whole) if row["inclusion[0].depth"] < 0.004]  # would stick out of the tissue
        assert buried
        assert {row["number"] for row in buried} <= {row["number"] for row in refused}
        assert all("inclusion" in row["reason"] and row["type"] and row["ratio"] is None for row in refused)
        assert len(list(rows(whole))) == 300

    def test_a_fault_of_the_program_is_a_row(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def broken(*_: object) -> None:
            raise ZeroDivisionError("by\nzero")

        monkeypatch.setattr("solver.evaluate", broken)
        job = Job.of(sweep_from_dict(grid(2, 2) | {"evaluator": "axisymmetric"}))
        (row,) = job.rows([(1e-4, 0.009)])
        assert (row["status"], row["type"], row["reason"]) == ("failed", "ZeroDivisionError", "by zero")

    def test_another_version_answers_nothing(self) -> None:
        job = Job.of(sweep_from_dict(grid(2, 2)))
        with pytest.raises(InputError, match="version"):
            Job(job.base, job.names, job.evaluator, job.accuracy, "0").rows([(1e-4, 0.009)])

    def test_starting_again_repeats_no_row_and_a_larger_grid_keeps_those_there(self, tmp_path: Path) -> None:
        assert sweep(grid(2, 2), tmp_path, workers=1).answered == 4
        seconds = [row["seconds"] for row in rows(tmp_path)]
        assert sweep(grid(2, 2), tmp_path, workers=1).answered == 0
        assert [row["seconds"] for row in rows(tmp_path)] == seconds
        assert sweep(grid(3, 2), tmp_path, workers=1).answered == 2  # the middle gap
        assert len(list(rows(tmp_path))) == 6

    def test_designs_that_are_the_same_are_answered_once(self, tmp_path: Path) -> None:
        found = sweep({"scene": SCENE, "evaluator": "closed-form", "variables": {"probe.gap": [1e-4, 1e-4, 2e-4]}}, tmp_path)
        assert (found.answered, found.ok) == (2, 3)


class TestSurvival:
    def test_the_design_that_kills_its_workers_fails_and_no_other(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        send = WorkerProcess._send

        def deadly(worker: WorkerProcess, line: str) -> None:
            if "[0.0002, " in line:
                worker.kill()
            send(worker, line)

        monkeypatch.setattr(WorkerProcess, "_send", deadly)
        monkeypatch.setattr("probe_design.sweep_run.SECONDS", 1e9)  # so that it shares a batch with others
        found = sweep(grid(4, 3), tmp_path, workers=1)
        assert (found.ok, found.failed) == (9, 3)
        for row in rows(tmp_path):
            assert (row["status"] == "failed") == (row["probe.gap"] == 2e-4)
        assert "killed by signal 9" in row["reason"]

    def test_twenty_kills_leave_what_no_kill_leaves(self, whole: Path, tmp_path: Path) -> None:
        chance, out, path = random.Random(8), tmp_path / "out", toml(tmp_path)
        kills, counts = 0, [0]
        begin = "from probe_design import sweep_run\nsweep_run.SECONDS = 0.02\n"
        for kill in range(20):
            process = subprocess.Popen(
                [sys.executable, "-c", f"{begin}sweep_run.sweep({str(path)!r}, {str(out)!r}, workers=1)"],
                cwd=ROOT, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip
            if kill % 2:
                wait_for_rows(out, counts[-1] + chance.randrange(1, 12), process)
                time.sleep(chance.random() * 0.05)
            else:  # while it starts, opens the store or notes the designs
                time.sleep(chance.random() * 1.5)
            os.killpg(process.pid, signal.SIGKILL)
            kills += process.wait() == -signal.SIGKILL
            counts.append(count(out))
            assert counts == sorted(counts)  # a row that was there is there
        assert kills == 20
        assert counts[-1] > 30  # they came in the middle of the work
        found = sweep(path, out, workers=2)
        assert found.answered < 300
        assert stored(out) == stored(whole)

    def test_interrupted_by_hand(self, whole: Path, tmp_path: Path) -> None:
        path = toml(tmp_path)
        process = subprocess.Popen(command(path, "-o", tmp_path / "out"), cwd=ROOT, stderr=subprocess.PIPE, text=True)
        wait_for_rows(tmp_path / "out", 1, process)
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=30)
        assert (process.returncode, "interrupted" in told, "Traceback" in told) == (130, True, False)
        sweep(path, tmp_path / "out")
        assert stored(tmp_path / "out") == stored(whole)

    def test_workers_that_do_not_start_are_one_line_and_no_rows(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("sys.executable", "/bin/false")
        with pytest.raises(CrewError, match=r"no worker process starts; .*workers\.log"):
            sweep(grid(2, 2), tmp_path)
        assert list(rows(tmp_path)) == []

    def test_a_second_process_is_refused_in_one_line(self, tmp_path: Path) -> None:
        with writing(tmp_path / "out"):
            ended = run(toml(tmp_path), "-o", tmp_path / "out")
        assert (ended.returncode, ended.stderr.count("\n")) == (2, 1)
        assert "no other sweep" in ended.stderr

    @pytest.mark.parametrize("room", [30_000, 100_000])
    def test_a_full_disk_is_one_line_and_the_rows_stay(self, room: int, whole: Path, tmp_path: Path) -> None:
        """Files may not grow beyond ``room`` bytes: the designs do not fit, or the rows do not."""
        import resource  # not on Windows

        path, limit = toml(tmp_path), lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
        ended = run(path, "-o", tmp_path / "out", preexec_fn=limit)
        assert (ended.returncode, ended.stderr.splitlines()[-1].count("kept")) == (1, 1)
        assert "Traceback" not in ended.stderr
        connection = sqlite3.connect(tmp_path / "out" / "sweep.sqlite")
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        connection.close()
        sweep(path, tmp_path / "out")
        assert stored(tmp_path / "out") == stored(whole)

    def test_two_of_four_dask_workers_are_killed(self, whole: Path, tmp_path: Path) -> None:
        program = f"""
import os, signal, threading, time
from pathlib import Path
import dask, distributed
from probe_design import sweep_run
from probe_design.sweep_store import reading
if __name__ == "__main__":
    dask.config.set({{"distributed.worker.daemon": True, "distributed.admin.log-format": "", "logging.distributed": "critical"}})
    sweep_run.SECONDS = 0.05
    out = {str(tmp_path / "out")!r}
    with distributed.LocalCluster(n_workers=4, threads_per_worker=1, dashboard_address=None, silence_logs=50) as cluster:
        pids = [worker.process.pid for worker in cluster.workers.values()]
        def kill(state):
            while pids[2:] and state.done >= 20:
                os.kill(pids.pop(), signal.SIGKILL)
        found = sweep_run.sweep({str(toml(tmp_path))!r}, out, scheduler=cluster.scheduler_address, progress=kill)
        print(found.ok + found.refused, found.failed, len(pids))
"""
        script = tmp_path / "program.py"
        script.write_text(program)
        ended = subprocess.run(
            [sys.executable, script],
            capture_output=True,
            text=True,
            cwd=ROOT,
            timeout=120,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
        )
        assert ended.stdout.split() == ["300", "0", "2"], ended.stderr[-2000:]
        assert stored(tmp_path / "out") == stored(whole)


class TestResults:
    def test_frame_and_dataset_agree_and_have_units(self, tmp_path: Path) -> None:
        sweep(grid(3, 2) | {"constraints": ["probe.gap < 1.9e-4 or inclusion.depth < 0.01"]}, tmp_path, workers=1)
        frame, cube = dataframe(tmp_path), dataset(tmp_path)
        assert cube["ratio"].dims == ("probe.gap", "inclusion.depth")
        assert cube["probe.gap"].attrs == {"units": "m"}
        assert cube["stress_inner"].attrs == {"units": "Pa"}
        assert bool(cube["ratio"].isnull().sel({"probe.gap": 2e-4, "inclusion.depth": 0.012}))  # left out by the constraint
        assert len(frame) == 5
        for _, row in frame.iterrows():
            at = {"probe.gap": row["probe.gap"], "inclusion.depth": row["inclusion.depth"]}
            assert float(cube["ratio"].sel(at)) == row["ratio"]

    def test_files_read_back_the_same(self, whole: Path, tmp_path: Path) -> None:
        import pandas as pd

        frame = dataframe(whole)
        pd.testing.assert_frame_equal(pd.read_parquet(to_parquet(whole, tmp_path / "a.parquet")), frame)
        with to_csv(whole, tmp_path / "a.csv").open(encoding="utf-8", newline="") as file:
            table = list(csv.DictReader(file))
        assert [float(row["probe.gap, m"]) for row in table] == frame["probe.gap"].tolist()
        assert [float(row["ratio"] or "nan") for row in table] == pytest.approx(
            frame["ratio"].tolist(), rel=0, abs=0, nan_ok=True
        )
        assert dataset(whole)["ratio"].dims == ("design",)

    def test_a_missing_library_is_one_line(self, whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "pandas", None)
        with pytest.raises(MissingLibrary, match=r"pip install '\.\[sweep\]'"):
            dataframe(whole)

    def test_main_effect_is_the_variance_of_the_means(self) -> None:
        x, noise = np.tile([0.0, 1.0], 50), np.repeat([-1.0, 1.0], 50)
        assert main_effect(list(x), 2 * x + noise) == pytest.approx(0.5)  # variances 1 and 1
        assert main_effect(list(range(4)), np.array([1.0, 2.0, 3.0, 4.0])) is None


def test_command_line(tmp_path: Path) -> None:
    path = tmp_path / "sweep.toml"
    path.write_text(
        f'scene = {json.dumps(str(SCENE))}\nevaluator = "closed-form"\n[sample]\n'
        'kind = "saltelli"\nn = 8\n[variables."probe.gap"]\n'
        'from = "0.05 mm"\nto = "0.2 mm"\n[variables."inclusion.depth"]\nfrom = "6 mm"\nto = "12 mm"\n'
    )
    ended = run(path, "-o", tmp_path / "out", "--json")
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)
    assert (found["designs"], found["ok"], found["refused"], found["failed"], found["answered"]) == (32, 32, 0, 0, 32)
    assert {Path(file).name for file in found["files"]} == {"results.csv", "results.parquet", "summary.html"}
    assert "32 of 32 done" in ended.stderr
    assert "32 of 32 done" in (tmp_path / "out" / "sweep.log").read_text()
    page = (tmp_path / "out" / "summary.html").read_text()
    assert "Sobol indices, 95 % intervals" in page
    assert "image/png" in page


@pytest.mark.parametrize(("scheduler", "code"), [("tcp://127.0.0.1:9", 2), ("nonsense://x", 2), ("nowhere", 2)])
def test_a_scheduler_that_is_not_there_is_one_line(scheduler: str, code: int, tmp_path: Path) -> None:
    ended = run(toml(tmp_path), "-o", tmp_path / "out", "--scheduler", scheduler)
    assert (ended.returncode, ended.stderr.splitlines()[-1].startswith("probe-design: scheduler = ")) == (code, True)
    assert "Traceback" not in ended.stderr


def count(folder: Path) -> int:
    if not (folder / "sweep.sqlite").exists():
        return 0
    connection = sqlite3.connect(folder / "sweep.sqlite", timeout=30)
    try:
        return int(connection.execute("SELECT count(*) FROM results").fetchone()[0])
    except sqlite3.OperationalError:  # no tables yet
        return 0
    finally:
        connection.close()


def wait_for_rows(folder: Path, wanted: int, process: subprocess.Popen[Any]) -> None:
    while count(folder) < wanted and process.poll() is None:
        time.sleep(0.01)
