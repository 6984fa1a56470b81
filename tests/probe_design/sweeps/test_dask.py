"""Sweeps on Dask clusters: workers and schedulers that die, slow ones, ones without this program."""

from __future__ import annotations

import gc
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from geometry import InputError
from geometry.common.resources import Limits
from geometry.processes import dask_executor
from geometry.processes import dask_task as sweep_remote
from geometry.processes.child import Child
from geometry.processes.dask_executor import DaskExecutor
from geometry.processes.executor import ExecutorError
from probe_design import sweep
from probe_design.sweeps import progress
from probe_design.sweeps.file import sweep_from_dict
from probe_design.sweeps.results import iterate_rows
from probe_design.sweeps.rows import Job
from tests.support.paths import ROOT
from tests.support.sweeps import command, grid, run, stored, toml, wait_for_rows

CLUSTER = """
import os, signal, sys
import dask, distributed
from geometry.processes import dask_executor as sweep_dask
from probe_design.sweeps import batches
from probe_design.sweeps import run as sweep_run

def main(path, out):
    dask.config.set({"distributed.worker.daemon": True, "logging.distributed": "critical"})
    batches.BATCH_TIME_S, sweep_dask.MIN_SLOW_BATCH_S, sweep_dask.FETCH_TIMEOUT_S = 0.05, 0.3, 0.5
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
    address = unused()
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
        _, errors = process.communicate(timeout=100)
    finally:
        end([*cluster, process])
    assert process.returncode == 0, errors
    assert [line for line in errors.splitlines() if not line.startswith("probe-design: ")] == []
    assert "scheduler is there again" in (tmp_path / "out" / "sweep.log").read_text()
    sweep(path, tmp_path / "alone")
    assert stored(tmp_path / "out") == stored(tmp_path / "alone")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("which", "stop", "message"),
    [
        (0, signal.SIGSTOP, "the Dask scheduler {} has not responded for"),
        (1, signal.SIGSTOP, "no Dask worker has responded for"),
        (1, signal.SIGKILL, "the Dask scheduler {} has had no worker for"),
    ],
)
def test_what_stops_is_told_of_and_may_go_on(
    which: int, stop: signal.Signals, message: str, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It goes on as soon as that is said, or another one is started."""
    monkeypatch.setattr(dask_executor, "SILENCE_INTERVAL_S", 2.0)
    monkeypatch.setattr("probe_design.sweeps.batches.BATCH_TIME_S", 0.02)
    address, lines = unused(), list[str]()
    cluster = begun(address)

    def act(state: progress.Progress) -> None:
        if state.done >= 20 and not lines:
            lines.append("stopped")
            cluster[which].send_signal(stop)

    def notice(line: str) -> None:
        lines.append(line)
        if stop == signal.SIGKILL and len(cluster) == 2:
            cluster.append(dask("worker", address, "--no-nanny", "--nthreads", "1"))
        elif stop == signal.SIGSTOP and line.startswith(message.format(address)):
            cluster[which].send_signal(signal.SIGCONT)

    try:
        wait_for_scheduler(address)
        sweep(toml(tmp_path), tmp_path / "out", scheduler=address, progress=act, notice=notice)
    finally:
        end(cluster)
    assert any(line.startswith(message.format(address)) for line in lines)
    assert lines[-1] in (tmp_path / "out" / "sweep.log").read_text()
    assert stored(tmp_path / "out") == stored(whole)


@pytest.mark.slow
def test_a_scheduler_that_stays_away_ends_the_sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_executor, "SILENCE_INTERVAL_S", 2.0)
    monkeypatch.setattr(dask_executor, "CONNECTION_TIMEOUT_S", 1.0)
    monkeypatch.setattr(dask_executor, "MAX_SCHEDULER_ABSENCE_S", 6.0)
    monkeypatch.setattr("probe_design.sweeps.batches.BATCH_TIME_S", 0.02)
    address, lines = unused(), list[str]()
    cluster = begun(address)

    def act(state: progress.Progress) -> None:
        if state.done >= 20:
            cluster[0].kill()

    try:
        wait_for_scheduler(address)
        with pytest.raises(ExecutorError, match=r"no scheduler for 6 s; all rows are kept, start again"):
            sweep(toml(tmp_path), tmp_path / "out", scheduler=address, progress=act, notice=lines.append)
    finally:
        end(cluster)
    assert lines[0] == "the Dask scheduler is gone"
    assert lines[1].startswith(f"the Dask scheduler {address} has been gone for")
    assert len(list(iterate_rows(tmp_path / "out"))) >= 20


def unused() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"tcp://127.0.0.1:{free.getsockname()[1]}"


def wait_for_scheduler(address: str) -> None:
    host, _, port = address.removeprefix("tcp://").partition(":")
    while True:
        with suppress(OSError), socket.create_connection((host, int(port))):
            return
        time.sleep(0.05)


def end(processes: Sequence[subprocess.Popen[Any]]) -> None:
    for process in processes:
        process.kill()
        process.wait()


def begun(address: str) -> list[subprocess.Popen[bytes]]:
    """A scheduler and a worker, which ends when its scheduler does."""
    port = address.rpartition(":")[2]
    return [dask("scheduler", "--port", port, "--host", "127.0.0.1"), dask("worker", address, "--no-nanny", "--nthreads", "1")]


def dask(*arguments: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "dask", *arguments, "--no-dashboard"]
    return subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL)


def test_workers_without_this_program_are_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")

    def missing(*_: object) -> None:
        raise ModuleNotFoundError("No module named\n'probe_design'")

    monkeypatch.setattr("geometry.processes.dask_executor.evaluate_batch", missing)
    with (
        distributed.LocalCluster(processes=False, n_workers=1, dashboard_address=":0", silence_logs=60) as cluster,
        pytest.raises(ExecutorError, match=r"cannot run this program.*ModuleNotFoundError: No module named 'probe_design'"),
    ):
        sweep(grid(2, 2), tmp_path, scheduler=cluster.scheduler_address)


@pytest.mark.slow
def test_a_dask_worker_keeps_its_process_for_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweep_remote, "MAX_IDLE_TIME_S", 2.0)
    started: list[int] = []
    begun = Child.__init__
    monkeypatch.setattr(Child, "__init__", lambda child, *words, **named: started.append(1) or begun(child, *words, **named))
    made_sweep = sweep_from_dict(grid(2, 2))
    job, designs = Job.from_sweep(made_sweep), [values for _, values in made_sweep.list_designs()]
    assert [len(sweep_remote.evaluate_batch(job, Limits(), designs[k:]).rows) for k in range(3)] == [4, 3, 2]
    assert len(started) == 1
    (kept,) = sweep_remote._IDLE_WORKERS
    assert kept._child is not None
    assert kept._child._process.wait(60) != 0  # ended by the pool
    assert sweep_remote._IDLE_WORKERS == {}


@pytest.mark.slow
def test_a_scheduler_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    program = (
        "from probe_design.__main__ import main; from geometry.processes import dask_executor as dask; "
        "dask.CONNECTION_TIMEOUT_S = 0.5; main()"
    )
    arguments = ["sweep", toml(tmp_path), "-o", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:9"]
    ended = subprocess.run([sys.executable, "-W", "error", "-c", program, *arguments], capture_output=True, text=True, cwd=ROOT)
    assert (ended.returncode, ended.stderr.splitlines()[-1].startswith("probe-design: scheduler = ")) == (2, True)
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize("scheduler", ["nonsense://x", "nowhere", "", "tls://127.0.0.1:9", "ucx://127.0.0.1:9", "inproc://1/2/3"])
def test_what_is_no_address_is_refused(scheduler: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^scheduler = "):
        sweep(grid(2, 2), tmp_path, scheduler=scheduler)


def silent(peer: socket.socket) -> None:
    peer.recv(1)
    peer.settimeout(60)
    with suppress(OSError):
        while peer.recv(65536):
            pass


def http(peer: socket.socket) -> None:
    peer.recv(65536)
    peer.sendall(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")


def garbage(peer: socket.socket) -> None:
    peer.sendall(random.Random(3).randbytes(100_000))
    silent(peer)


def closing(peer: socket.socket) -> None:
    peer.close()


def endless(peer: socket.socket) -> None:
    """A frame of 16 bytes, then ones for ever."""
    with suppress(OSError):
        peer.sendall((1).to_bytes(8, "little") + (16).to_bytes(8, "little") + b"\xff" * 4096)
        silent(peer)


@pytest.fixture
def served() -> Iterator[Callable[[Callable[[socket.socket], None]], str]]:
    """Servers of one thread for each peer."""
    listeners = []

    def begin(behaviour: Callable[[socket.socket], None]) -> str:
        listener = socket.create_server(("127.0.0.1", 0))
        listeners.append(listener)

        def serve() -> None:
            with suppress(OSError):
                while True:
                    threading.Thread(target=answer, args=(listener.accept()[0],), daemon=True).start()

        def answer(peer: socket.socket) -> None:
            with suppress(OSError), peer:
                behaviour(peer)

        threading.Thread(target=serve, daemon=True).start()
        return f"tcp://127.0.0.1:{listener.getsockname()[1]}"

    yield begin
    for listener in listeners:
        listener.close()


NONE = "what responds there is no Dask scheduler"


@pytest.mark.parametrize(
    ("behaviour", "reason"),
    [(silent, "no response in time|Timed out"), (http, NONE), (garbage, NONE), (closing, "."), (endless, NONE)],
)
def test_what_is_no_scheduler_is_refused(
    behaviour: Callable[[socket.socket], None],
    reason: str,
    served: Callable[[Callable[[socket.socket], None]], str],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """However it responds, or does not: nothing else is printed, and nothing waited for."""
    pytest.importorskip("distributed")
    if behaviour is silent:
        monkeypatch.setattr(dask_executor, "CONNECTION_TIMEOUT_S", 0.2)
    address = served(behaviour)
    with pytest.raises(
        InputError, match=rf"^scheduler = '{address}': allowed: the address of a Dask scheduler, tcp://host:8786 \(({reason})"
    ):
        DaskExecutor(Job.from_sweep(sweep_from_dict(grid(2, 2))), address, Limits(), print)
    gc.collect()
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_dask_s_own_other_ports_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The dashboard's, which speaks HTTP, and a worker's, which speaks Dask's language."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        processes=False, n_workers=1, protocol="tcp", dashboard_address="127.0.0.1:0", silence_logs=60
    ) as cluster:
        (worker,) = cluster.workers.values()
        port = cluster.scheduler.http_server.port
        for address, reason in (
            (f"tcp://127.0.0.1:{port}", "no response in time"),
            (worker.address, "what responds there is a Dask Worker"),
        ):
            with pytest.raises(InputError, match=rf"^scheduler = '{address}'.*\({reason}\)"):
                DaskExecutor(Job.from_sweep(sweep_from_dict(grid(2, 2))), address, Limits(), print)


@pytest.mark.slow
def test_the_program_ends_with_one_line(served: Callable[[Callable[[socket.socket], None]], str], tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    ended = run(toml(tmp_path), "-o", tmp_path / "out", "--scheduler", served(http))
    assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1)
    assert "(what responds there is no Dask scheduler)" in ended.stderr


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
    messages: list[str] = []
    now = [0.0]
    monkeypatch.setattr(dask_executor.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(dask_executor, "monotonic", lambda: now[0])
    monkeypatch.setattr(DaskExecutor, "_connect_client", lambda crew: Still(10))
    crew = DaskExecutor(Job.from_sweep(sweep_from_dict(grid(2, 2))), "tcp://127.0.0.1:8786", Limits(), messages.append)
    for now[0] in range(20, 240, 20):
        crew.collect(0.0)
    assert [line.partition(" for ")[2] for line in messages] == [f"{s} s; start it again, or wait" for s in (60, 120, 180)]
    assert (now[0], crew.count_workers()) == (220, 3)
    crew._set_log_levels(crew._log_levels)
