"""Robustness tests of more than one step: a sweep's work and store, its cluster, and how any command ends.

Each asks the program in processes of its own, and compares what is left with what nobody disturbed leaves.
"""

from __future__ import annotations

import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.robustness.attempt import Ended
from benchmarks.robustness.damage import Random
from probe_design.sweeps.store import STORE_FILE
from tests.support.interrupted import Leftovers, left, moments
from tests.support.paths import ROOT, SCENE
from tests.support.sweeps import command, stored, toml, wait_for_rows

DESIGNS, PATIENCE_S = 200, 120.0
LOST_ROWS, STRAY_LINES = "lost rows", "stray lines"
NOWHERE = ("tls://127.0.0.1:9", "ucx://127.0.0.1:9", "nowhere", "tcp://127.0.0.1:1", "")
SLOW_SWEEP_SCRIPT = (
    "from probe_design.__main__ import main; from probe_design.sweeps import batches; batches.BATCH_TIME_S = 0.02; main()"
)
COMMANDS = (
    ("evaluate", str(SCENE), "--json"), ("plan", str(SCENE)), ("export", str(SCENE), "-o", "OUT"), ("tradeoff", "-o", "OUT"),
    ("curve", str(SCENE), "--points", "5", "--plot", "OUT/curve.png"), ("read", str(SCENE), "--virtual", "--seconds", "3"),
)  # fmt: skip


@dataclass(frozen=True)
class Trial:
    """One trial: what was done, how the program ended, and every failure."""

    said: str
    ended: Ended
    wrong: tuple[str, ...]


def kill(draw: Random, folder: Path) -> Trial:
    """Kill a sweep at any moment, up to three times, and start it again."""
    path, output_folder, kills = toml(folder, n=DESIGNS), folder / "out", draw.randint(1, 3)
    for _ in range(kills):
        words = [sys.executable, "-c", SLOW_SWEEP_SCRIPT, "sweep", str(path), "-o", str(output_folder), "--workers", "1"]
        process = subprocess.Popen(words, cwd=ROOT, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        if draw.random() < 0.6:
            wait_for_rows(output_folder, draw.randint(1, DESIGNS // 2), process)
        time.sleep(draw.random())
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    return _check_resumed(f"{kills} kills", path, output_folder)


def full_disk(draw: Random, folder: Path) -> Trial:
    """Run a sweep whose files may not grow beyond some kB, then again without the limit."""
    path, output_folder, room = toml(folder, n=DESIGNS), folder / "out", draw.randint(4, 60) * 1000
    first = _sweep_again(path, output_folder, lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (room, room)))
    resumed = _check_resumed(f"files of {room} bytes at most", path, output_folder)
    wrong = () if first.code in (0, 1, 2) else ("exit code",)
    return Trial(resumed.said, resumed.ended, (*_lines(first), *wrong, *resumed.wrong))


def store(draw: Random, folder: Path) -> Trial:
    """Damage or cut a store: it must be repaired or refused, and never give another table."""
    path, output_folder = toml(folder, n=DESIGNS), folder / "out"
    shutil.copytree(_whole()[0], output_folder)
    content = bytearray((output_folder / STORE_FILE).read_bytes())
    kind = draw.choice(["bits", "bits", "cut", "sector"])
    if kind == "bits":
        for _ in range(draw.choice([1, 1, 30])):
            content[draw.randrange(len(content))] ^= 1 << draw.randrange(8)
    elif kind == "cut":
        del content[draw.randrange(len(content)) :]
    else:
        offset = draw.randrange(len(content) // 512) * 512
        content[offset : offset + 512] = bytes(512)
    (output_folder / STORE_FILE).write_bytes(content)
    return _check_resumed(kind, path, output_folder, refusable=True)


def scheduler(draw: Random, folder: Path) -> Trial:
    """Run with a scheduler's address at which there is nothing, rubbish or another service, or with an invalid address."""
    behaviour = draw.choice([*BEHAVIOURS, None])
    with _server(BEHAVIOURS.get(behaviour or "", _close), draw) as address:
        given = (
            address if behaviour else draw.choice(["tls://127.0.0.1:9", "ucx://127.0.0.1:9", "nowhere", "tcp://127.0.0.1:1", ""])
        )
        ended = _sweep_again(toml(folder, n=4), folder / "out", lambda: None, "--scheduler", given)
    return Trial(str(behaviour or given), ended, (*_lines(ended), *(() if ended.code == 2 else ("exit code",))))


def interrupt(draw: Random, folder: Path) -> Trial:
    """Send a signal at any moment of any command."""
    words = draw.choice(COMMANDS)
    (delay, number), start = next(moments(_find_undisturbed(words).seconds, 1, draw.randrange(2**32))), time.perf_counter()
    leftovers = left(words, delay, number)
    fault = leftovers.wrong(number, _find_undisturbed(words))
    ended = Ended(leftovers.code, "", leftovers.said, time.perf_counter() - start)
    return Trial(f"signal {number} after {delay:.2f} s: {fault}", ended, ("exit code",) if fault else ())


TRIALS: dict[str, Callable[[Random, Path], Trial]] = {
    "kills": kill, "full disks": full_disk, "stores": store, "schedulers": scheduler, "interrupts": interrupt,
}  # fmt: skip


def _sweep_again(path: Path, output_folder: Path, prepare: Callable[[], Any], *extra_words: str) -> Ended:
    start, words = time.perf_counter(), command(path, "-o", output_folder, "--workers", "1", *extra_words)
    try:
        done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT, timeout=PATIENCE_S, preexec_fn=prepare)
    except subprocess.TimeoutExpired:
        return Ended(None, "", "", time.perf_counter() - start)
    return Ended(done.returncode, done.stdout, done.stderr, time.perf_counter() - start)


def _check_resumed(said: str, path: Path, output_folder: Path, refusable: bool = False) -> Trial:
    ended = _sweep_again(path, output_folder, lambda: None)
    if ended.code == 2 and refusable:
        return Trial(said, ended, tuple(_lines(ended)))
    is_same = ended.code == 0 and stored(output_folder) == _whole()[1]
    return Trial(said, ended, (*_lines(ended), *(() if is_same else (LOST_ROWS,))))


def _lines(ended: Ended) -> Iterator[str]:
    if ended.code is None:
        yield "hang"
    elif ended.code < 0:
        yield "signal"
    if "Traceback" in ended.errors:
        yield "traceback"
    if "a defect of the program" in ended.errors:
        yield "defect"
    if any(not line.startswith("probe-design: ") for line in ended.errors.splitlines()):
        yield STRAY_LINES


@cache
def _whole() -> tuple[Path, list[tuple[Any, ...]]]:
    """Return the store of an undisturbed sweep, and its rows."""
    folder = Path(tempfile.mkdtemp(prefix="robustness-whole-"))
    assert _sweep_again(toml(folder, n=DESIGNS), folder / "out", lambda: None).code == 0
    return folder / "out", stored(folder / "out")


@cache
def _find_undisturbed(words: tuple[str, ...]) -> Leftovers:
    return left(words)


@contextmanager
def _server(behaviour: Callable[[socket.socket, Random], None], draw: Random) -> Iterator[str]:
    """Serve every peer in a thread of its own."""
    listener = socket.create_server(("127.0.0.1", 0))

    def answer(peer: socket.socket) -> None:
        with suppress(OSError), peer:
            behaviour(peer, draw)

    def serve() -> None:
        with suppress(OSError):
            while True:
                threading.Thread(target=answer, args=(listener.accept()[0],), daemon=True).start()

    threading.Thread(target=serve, daemon=True).start()
    try:
        yield f"tcp://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        listener.close()


def _silent(peer: socket.socket, _: Random) -> None:
    peer.settimeout(PATIENCE_S)
    while peer.recv(65536):
        pass


def _http(peer: socket.socket, _: Random) -> None:
    peer.recv(65536)
    peer.sendall(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")


def _rubbish(peer: socket.socket, draw: Random) -> None:
    peer.sendall(draw.randbytes(draw.randint(1, 100_000)))
    _silent(peer, draw)


def _close(peer: socket.socket, _: Random) -> None:
    peer.close()


def _frames(peer: socket.socket, draw: Random) -> None:
    """Return the beginning of a frame of Dask's, of any length, whose rest is never sent."""
    peer.sendall((1).to_bytes(8, "little") + draw.choice([16, 2**20, 2**50]).to_bytes(8, "little") + b"\xff" * 4096)
    _silent(peer, draw)


BEHAVIOURS = {"silent": _silent, "HTTP": _http, "rubbish": _rubbish, "closes": _close, "frames without an end": _frames}
