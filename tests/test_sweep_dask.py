"""Sweeps on Dask clusters: workers and schedulers that die, slow ones, ones without this program."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from sweeps import ROOT, run, stored, toml


class TestCluster:
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


@pytest.mark.parametrize(("scheduler", "code"), [("tcp://127.0.0.1:9", 2), ("nonsense://x", 2), ("nowhere", 2)])
def test_a_scheduler_that_is_not_there_is_one_line(scheduler: str, code: int, tmp_path: Path) -> None:
    ended = run(toml(tmp_path), "-o", tmp_path / "out", "--scheduler", scheduler)
    assert (ended.returncode, ended.stderr.splitlines()[-1].startswith("probe-design: scheduler = ")) == (code, True)
    assert "Traceback" not in ended.stderr
