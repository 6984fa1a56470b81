"""Sweeps on Dask clusters: workers and schedulers that die, slow ones, ones without this program."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from geometry import InputError
from probe_design import sweep
from probe_design.sweeps import dask_task as sweep_remote
from probe_design.sweeps import dask_workers
from probe_design.sweeps.dask_workers import DaskCrew
from probe_design.sweeps.file import sweep_from_dict
from probe_design.sweeps.local_workers import WorkerProcess
from probe_design.sweeps.rows import Job
from probe_design.sweeps.workers import CrewError
from tests.support.paths import ROOT
from tests.support.sweeps import command, grid, stored, toml, wait_for_rows

CLUSTER = """
import os, signal, sys
import dask, distributed
from probe_design.sweeps import dask_workers as sweep_dask
from probe_design.sweeps import run as sweep_run

def main(path, out):
    dask.config.set({"distributed.worker.daemon": True, "logging.distributed": "critical"})
    sweep_run.SECONDS, sweep_dask.LEAST, sweep_dask.FETCH = 0.05, 0.3, 0.5
    with distributed.LocalCluster(n_workers=4, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as cluster:
        pids = [worker.process.pid for worker in cluster.workers.values()]
        signals = [signal.SIGSTOP, signal.SIGKILL, signal.SIGKILL]
        def act(state):
            while signals and state.done >= 20:
                os.kill(pids[len(signals)], signals.pop())
        found = sweep_run.sweep(path, out, scheduler=cluster.scheduler_address, progress=act)
        os.kill(pids[1], signal.SIGCONT)
        print(found.ok + found.refused, found.failed, len(signals))

if __name__ == "__main__":
    main(*sys.argv[1:])
"""


@pytest.mark.slow
def test_two_of_four_workers_die_and_one_stands_still(whole: Path, tmp_path: Path) -> None:
    """The one that stands still keeps its batches, which others are given too."""
    script = tmp_path / "program.py"
    script.write_text(CLUSTER)
    arguments = [sys.executable, script, toml(tmp_path), tmp_path / "out"]
    done = subprocess.run(
        arguments, capture_output=True, text=True, cwd=ROOT, timeout=120, env=os.environ | {"PYTHONPATH": str(ROOT)}
    )
    assert done.stdout.split() == ["300", "0", "0"], done.stderr[-2000:]
    assert stored(tmp_path / "out") == stored(whole)
    assert "takes long" in (tmp_path / "out" / "sweep.log").read_text()


@pytest.mark.slow
def test_a_scheduler_that_dies_and_comes_back(tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    path = tmp_path / "sweep.toml"
    path.write_text(toml(tmp_path, n=12).read_text().replace('"closed-form"', '"axisymmetric"'))
    cluster = begun(address)
    process = subprocess.Popen(
        command(path, "-o", tmp_path / "out", "--scheduler", address), cwd=ROOT, stderr=subprocess.PIPE, text=True
    )
    try:
        wait_for_rows(tmp_path / "out", 3, process)
        cluster[0].kill()
        cluster += begun(address)
        _, told = process.communicate(timeout=100)
    finally:
        for one in (*cluster, process):
            one.kill()
            one.wait()
    assert process.returncode == 0, told
    assert [line for line in told.splitlines() if not line.startswith("probe-design: ")] == []
    assert "scheduler is there again" in (tmp_path / "out" / "sweep.log").read_text()
    sweep(path, tmp_path / "alone")
    assert stored(tmp_path / "out") == stored(tmp_path / "alone")


def begun(address: str) -> list[subprocess.Popen[bytes]]:
    """A scheduler and a worker, which ends when its scheduler does."""
    port = address.rpartition(":")[2]
    programs = [["scheduler", "--port", port, "--host", "127.0.0.1"], ["worker", address, "--no-nanny", "--nthreads", "1"]]
    return [
        subprocess.Popen([sys.executable, "-m", "dask", *program, "--no-dashboard"], cwd=ROOT, stderr=subprocess.DEVNULL)
        for program in programs
    ]


def test_workers_without_this_program_are_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")

    def missing(*_: object) -> None:
        raise ModuleNotFoundError("No module named\n'probe_design'")

    monkeypatch.setattr("probe_design.sweeps.dask_workers.answered", missing)
    with (
        distributed.LocalCluster(processes=False, n_workers=1, dashboard_address=":0", silence_logs=60) as cluster,
        pytest.raises(CrewError, match=r"cannot run this program.*ModuleNotFoundError: No module named 'probe_design'"),
    ):
        sweep(grid(2, 2), tmp_path, scheduler=cluster.scheduler_address)


@pytest.mark.slow
def test_a_dask_worker_keeps_its_process_for_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweep_remote, "IDLE", 2.0)
    started: list[int] = []
    begun = WorkerProcess._begun
    monkeypatch.setattr(WorkerProcess, "_begun", lambda worker: bool(started.append(1)) or begun(worker))
    asked = sweep_from_dict(grid(2, 2))
    job, designs = Job.of(asked), [values for _, values in asked.designs()]
    assert [len(sweep_remote.answered(job, None, designs[k:]).rows) for k in range(3)] == [4, 3, 2]
    assert len(started) == 1
    (_, _, kept), *_ = sweep_remote._POOL._idle
    process = kept._process
    assert process is not None
    assert process.wait(60) != 0  # ended by the pool
    assert sweep_remote._POOL._idle == []


def test_a_scheduler_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    program = (
        "from probe_design.__main__ import main; from probe_design.sweeps import dask_workers as dask; dask.CONNECT = 0.5; main()"
    )
    arguments = ["sweep", toml(tmp_path), "-o", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:9"]
    ended = subprocess.run([sys.executable, "-W", "error", "-c", program, *arguments], capture_output=True, text=True, cwd=ROOT)
    assert (ended.returncode, ended.stderr.splitlines()[-1].startswith("probe-design: scheduler = ")) == (2, True)
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize("scheduler", ["nonsense://x", "nowhere", ""])
def test_what_is_no_address_is_refused(scheduler: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^scheduler = "):
        sweep(grid(2, 2), tmp_path, scheduler=scheduler)


class Still:
    """A client of a scheduler that stands still, and goes on after some questions."""

    status, scheduler = "running", SimpleNamespace(ncores=None)

    def __init__(self, silent: int) -> None:
        self.silent = silent

    def sync(self, *_: object, **__: object) -> dict[str, int]:
        self.silent -= 1
        if self.silent >= 0:
            raise TimeoutError
        return {"one": 3}


def test_a_scheduler_that_stands_still_is_told_of_once_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    told: list[str] = []
    now = [0.0]
    monkeypatch.setattr(dask_workers.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(DaskCrew, "_connected", lambda crew: Still(10))
    crew = DaskCrew(Job.of(sweep_from_dict(grid(2, 2))), "tcp://127.0.0.1:8786", None, told.append)
    for now[0] in range(20, 240, 20):
        crew.take(0.0)
    assert [line.partition(" for ")[2] for line in told] == [f"{s} s; start it again, or wait" for s in (60, 120, 180)]
    assert (now[0], crew.size()) == (220, 3)
    crew._hush(crew._levels)
