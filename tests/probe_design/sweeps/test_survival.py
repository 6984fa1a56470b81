"""Sweeps through kills, full disks, deadly and endless designs: the table is that of a sweep that nothing interrupted."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import pytest

from geometry.processes.child import Child
from geometry.processes.executor import ExecutorError
from geometry.processes.local_executor import Worker
from probe_design import sweep
from probe_design.sweeps.file import sweep_from_dict
from probe_design.sweeps.results import iterate_rows
from probe_design.sweeps.rows import Job
from tests.support.paths import ROOT, SCENE
from tests.support.sweeps import count, grid, run, stored, toml, wait_for_rows


class TestSurvival:
    @pytest.mark.slow
    def test_the_design_that_kills_its_workers_fails_and_no_other(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        send = Child.send

        def deadly(child: Child, request: Any) -> None:
            if any(gap == 2e-4 for gap, _ in request[2] or ()):
                child.kill()
            send(child, request)

        monkeypatch.setattr(Child, "send", deadly)
        monkeypatch.setattr("probe_design.sweeps.batches.BATCH_TIME_S", 1e9)  # so that it shares a batch with others
        results = sweep(grid(4, 2), tmp_path, workers=1)
        assert (results.ok, results.failed) == (6, 2)
        for row in iterate_rows(tmp_path):
            assert (row["status"] == "failed") == (row["probe.gap"] == 2e-4)
        assert "ended by SIGKILL" in row["reason"]

    @pytest.mark.slow
    def test_kills_leave_what_no_kill_leaves(self, tmp_path: Path) -> None:
        chance, folder, path = random.Random(8), tmp_path / "out", toml(tmp_path, n=6000)  # so many that no kill comes too late
        kills, counts = 0, [0]
        begin = "from probe_design.sweeps import batches, run\nbatches.BATCH_TIME_S = 0.02\n"
        for kill in range(10):  # benchmarks.robustness has more
            with (tmp_path / "stderr").open("wb") as errors:
                process = subprocess.Popen(
                    [sys.executable, "-c", f"{begin}run.sweep({str(path)!r}, {str(folder)!r}, workers=1)"],
                    cwd=ROOT, start_new_session=True, stdout=subprocess.DEVNULL, stderr=errors,
                )  # fmt: skip
            if kill % 2:
                wait_for_rows(folder, counts[-1] + chance.randrange(1, 12), process)
                time.sleep(chance.random() * 0.05)
            else:  # while it starts, opens the store or notes the designs
                time.sleep(chance.random() * 1.5)
            assert process.poll() is None, (tmp_path / "stderr").read_text()
            os.killpg(process.pid, signal.SIGKILL)
            kills += process.wait() == -signal.SIGKILL
            counts.append(count(folder))
            assert counts == sorted(counts)  # a row that was there is there
        assert kills == 10
        assert counts[-1] > 15  # they came in the middle of the work
        results = sweep(path, folder, workers=2)
        assert results.answered < 6000
        sweep(path, tmp_path / "whole", workers=2)
        assert stored(folder) == stored(tmp_path / "whole")

    @pytest.mark.slow
    @pytest.mark.timeout(1200)
    def test_pressed_designs_killed_midway_are_all_there_after_all(self, tmp_path: Path) -> None:
        """``contact`` under loads beyond linear elasticity, one of which no step reaches."""
        loads = {"values": [0.02, 0.06, 40.0, 0.1]}
        job = {
            "scene": str(SCENE),
            "evaluator": "contact",
            "accuracy": 0.05,
            "variables": {"load.force": loads},
            "time_limit": 900.0,
        }
        folder, begin = (
            tmp_path / "out",
            "from probe_design import sweep\nfrom probe_design.sweeps import batches\nbatches.BATCH_TIME_S = 0.01\n",
        )
        process = subprocess.Popen(
            [sys.executable, "-c", f"{begin}sweep({job!r}, {str(folder)!r}, workers=1)"],
            cwd=ROOT, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        wait_for_rows(folder, 2, process)
        os.killpg(process.pid, signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
        kept = count(folder)
        assert 2 <= kept < 4
        results = sweep(job, folder, workers=1)
        assert (results.ok, results.refused, results.failed, results.answered) == (3, 1, 0, 4 - kept)
        sweep(job, tmp_path / "whole", workers=1)
        assert stored(folder) == stored(tmp_path / "whole")
        assert "for contact" in next(row["reason"] for row in iterate_rows(folder) if row["status"] == "refused")

    @pytest.mark.slow
    def test_a_second_process_is_refused_and_ctrl_c_keeps_what_is_there(self, whole: Path, tmp_path: Path) -> None:
        path, folder = toml(tmp_path), tmp_path / "out"
        slow = (
            "from probe_design.__main__ import main; from probe_design.sweeps import batches; batches.BATCH_TIME_S = 0.01; main()"
        )
        first = subprocess.Popen(
            [sys.executable, "-c", slow, "sweep", path, "-o", folder], cwd=ROOT, stderr=subprocess.PIPE, text=True
        )
        wait_for_rows(folder, 1, first)
        first.send_signal(signal.SIGSTOP)  # in the middle, for as long as the second one takes
        second = run(path, "-o", folder)
        assert (second.returncode, second.stderr.count("\n")) == (2, 1)
        assert "no other sweep" in second.stderr
        first.send_signal(signal.SIGINT)
        first.send_signal(signal.SIGCONT)
        _, errors = first.communicate(timeout=30)
        assert (first.returncode, "interrupted" in errors, "Traceback" in errors) == (130, True, False)
        assert count(folder) < 300
        sweep(path, folder)
        assert stored(folder) == stored(whole)

    @pytest.mark.slow
    def test_the_design_that_takes_too_long_fails_and_no_other(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """A worker that is stopped in the middle is treated like one that computes for ever."""
        receive = Child.receive

        def endless(child: Child) -> Any:
            if order.pop() == 4:
                os.kill(child.process_id, signal.SIGSTOP)
            return receive(child)

        order = [*range(40, 0, -1)]  # the second row is held up: before it come readiness, the first row and its end
        monkeypatch.setattr(Child, "receive", endless)
        monkeypatch.setattr("probe_design.sweeps.batches.BATCH_TIME_S", 1e9)
        job = grid(3, 2) | {"evaluator": "axisymmetric", "time_limit": 4.0}
        results = sweep(job, tmp_path, workers=1)
        assert (results.ok, results.failed) == (5, 1)
        (late,) = [row for row in iterate_rows(tmp_path) if row["status"] == "failed"]
        assert (late["type"], late["reason"]) == ("TimeLimit", "took longer than 4 s")
        repeated = sweep(job, tmp_path, workers=1)
        assert (repeated.failed, repeated.answered) == (1, 0)
        repeated = sweep(job | {"time_limit": None}, tmp_path, workers=1, retry_failed=True)
        assert (repeated.ok, repeated.failed, repeated.answered) == (6, 0, 1)

    @pytest.mark.slow
    def test_formulas_too_have_a_time_limit(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """Of designs that are evaluated together each is tried alone, and the one that is held up fails."""
        send, held = Child.send, sweep_from_dict(grid(4, 4)).list_designs()[4][1]
        sizes = []

        def endless(child: Child, request: Any) -> None:
            if held in (request[2] or ()):
                sizes.append(len(request[2]))
                os.kill(child.process_id, signal.SIGSTOP)
            send(child, request)

        monkeypatch.setattr(Child, "send", endless)
        monkeypatch.setattr("probe_design.sweeps.batches.BATCH_TIME_S", 1e9)
        results = sweep(grid(4, 4) | {"time_limit": 4.0}, tmp_path, workers=1)  # which a busy machine keeps
        assert (results.ok, results.failed) == (15, 1)
        assert sizes == [3, 1]  # the third batch, then alone
        assert [row["number"] for row in iterate_rows(tmp_path) if row["type"] == "TimeLimit"] == [4]

    def test_workers_that_do_not_start_are_one_line_and_no_rows(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("sys.executable", "/bin/false")
        with pytest.raises(ExecutorError, match=r"no worker process starts; .*workers\.log"):
            sweep(grid(2, 2), tmp_path)
        assert list(iterate_rows(tmp_path)) == []

    @pytest.mark.slow
    @pytest.mark.skipif(not os.path.exists("/proc/self/environ"), reason="reads a process's environment where Linux has it")
    def test_what_a_killed_worker_leaves_among_temporary_files_goes_with_it(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
        checked = sweep_from_dict(grid(2, 2))
        worker = Worker(Job.from_sweep(checked), checked.limits, 2)
        assert worker.evaluate([values for _, values in checked.list_designs()]).rows
        assert worker._child is not None
        environment = Path(f"/proc/{worker._child.process_id}/environ").read_bytes().split(b"\0")
        (folder,) = tmp_path.iterdir()
        assert f"TMPDIR={folder}".encode() in environment
        (folder / "surface-1").mkdir()
        worker.stop()
        assert list(tmp_path.iterdir()) == []
