"""Programs in processes of their own, which can be stopped at any time; a crash raises an exception.

A program is a file with a function ``run`` from arrays by name to arrays by name. The child runs this very file, so that it loads
no more than numpy before the program; arrays go there and come back through pipes, and its folder is removed, so that no files
are left behind. Its exceptions are reported in one line.
"""

from __future__ import annotations

import contextvars
import io
import math
import os
import runpy
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

_INTERRUPT_EXIT_CODES = (-int(signal.SIGINT), 128 + int(signal.SIGINT), 0xC000013A)  # what a process ends with after Ctrl-C
_PROGRAM_ERROR_EXIT_CODE = 3  # the program's own exceptions; everything else is a crash
Arrays = Mapping[str, NDArray[Any]]


class Failure(Exception):  # noqa: N818 - what the process says, not yet an error of the toolkit
    """The program returned no result; the text gives the reason."""


class TooLong(Failure):
    """The program did not end within the limit."""


class ProgramGroup:
    """Programs that several threads run and that end, with those still to come, when the block is left by an exception.

    Threads cannot be interrupted: without this Ctrl-C would wait until they are done.

    Example:
        >>> with ThreadPoolExecutor(2) as pool, ProgramGroup() as group:  # doctest: +SKIP
        ...     answers = [pool.submit(group.context().run, run_program, *one) for one in questions]
    """

    def __init__(self) -> None:
        self._children: list[subprocess.Popen[bytes]] = []
        self._ended, self._lock = False, threading.Lock()

    def context(self) -> contextvars.Context:
        """Return a copy of the context in which programs belong to the group."""
        context = contextvars.copy_context()
        context.run(_CURRENT_GROUP.set, self)
        return context

    def add(self, child: subprocess.Popen[bytes]) -> None:
        """Add a process to the group."""
        with self._lock:
            self._children = [running for running in self._children if running.returncode is None] + [child]
            if self._ended:
                child.kill()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None) -> None:
        if kind is not None:
            with self._lock:
                self._ended = True
                for child in self._children:
                    child.kill()


_CURRENT_GROUP: contextvars.ContextVar[ProgramGroup | None] = contextvars.ContextVar("group", default=None)


def run_program(program: Path, arrays: Arrays, seconds: float, memory: float | None = None) -> dict[str, NDArray[Any]]:
    """Run a program in a child process that takes one core; safe in several threads at a time.

    Args:
        program: its file.
        arrays: what its function ``run`` is given.
        seconds: after which the child is ended.
        memory: bytes that it may hold, where the system can see to that (Linux); or None.

    Returns:
        What ``run`` returns.

    Raises:
        TooLong: it took longer than ``seconds``.
        Failure: the program fails or its process ends early.
        KeyboardInterrupt: Ctrl-C, here or in the child, which is gone by then.
    """
    if seconds <= 0:
        raise TooLong("no time is left for it")
    with tempfile.TemporaryDirectory(prefix=f"{program.stem}-", ignore_cleanup_errors=True) as folder:
        return _run([str(program), str(math.ceil(seconds)), str(int(memory or 0))], arrays, seconds, folder)


def _run(arguments: list[str], arrays: Arrays, seconds: float, folder: str) -> dict[str, NDArray[Any]]:
    """Start the child in a folder of its own, where libraries leave files, and wait for it."""
    try:
        child = subprocess.Popen(
            [sys.executable, "-P", os.path.abspath(__file__), *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=_build_environment(),
            cwd=folder,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    except OSError as fault:
        raise Failure(f"no process can be started for it ({fault})") from fault
    with child:
        try:
            if (group := _CURRENT_GROUP.get()) is not None:
                group.add(child)
            stdout, stderr = child.communicate(_pack(arrays), timeout=seconds)
        except subprocess.TimeoutExpired:
            raise TooLong(f"it took longer than {seconds:.3g} s") from None
        finally:
            child.kill()
            child.wait()
    if child.returncode in _INTERRUPT_EXIT_CODES:
        raise KeyboardInterrupt
    if child.returncode != 0:
        raise (TooLong if child.returncode == -_alarm_signal() else Failure)(_describe_end(child.returncode, stderr))
    return _unpack(stdout)


def _build_environment() -> dict[str, str]:
    """Return parent's environment with one thread and the parent's module path, so that the child imports the same libraries."""
    path = os.pathsep.join(os.path.abspath(entry) for entry in sys.path if entry)
    return {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": path, "PYTHONWARNINGS": "ignore"}


def _describe_end(code: int, stderr: bytes) -> str:
    lines = stderr.decode(errors="replace").strip().splitlines()
    last = f": {lines[-1]}" if lines else ""
    if code == _PROGRAM_ERROR_EXIT_CODE:
        return last.removeprefix(": ") or "it gives no reason"
    if code == -_alarm_signal():
        return "it took too long"
    if code < 0:
        name = next((known.name for known in signal.Signals if known == -code), f"signal {-code}")
        return f"its process was ended by {name}{last}"
    return f"its process ended with code {code:#x}{last}"


def _alarm_signal() -> int:
    return int(getattr(signal, "SIGALRM", 0))


def _pack(arrays: Arrays) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def _unpack(content: bytes) -> dict[str, NDArray[Any]]:
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        return dict(arrays)


def _run_child(program: str, seconds: int, memory: int) -> int:
    """Read arguments from stdin, run the program, write its results to stdout; return the exit code."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # at once, whatever is running, and without a word
    if hasattr(signal, "alarm"):
        signal.alarm(seconds + 5)  # the limit holds even if the parent is killed
    if memory:
        _limit_memory(memory)
    answer = os.fdopen(os.dup(1), "wb")
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    arguments = _unpack(sys.stdin.buffer.read())
    try:
        results = runpy.run_path(program)["run"](arguments)
    except MemoryError:
        sys.stderr.write("it needs more memory than it may have\n")
        return _PROGRAM_ERROR_EXIT_CODE
    except Exception as fault:  # libraries raise what they like
        text = " ".join(str(fault).split()) or type(fault).__name__
        sys.stderr.write(f"{text}\n")
        return _PROGRAM_ERROR_EXIT_CODE
    answer.write(_pack(results))
    answer.close()
    return 0


def _limit_memory(memory: int) -> None:
    """Limit the process's data to ``memory`` bytes, where the system can (Linux)."""
    with suppress(ImportError, AttributeError, OSError, ValueError):
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))


if __name__ == "__main__":
    sys.exit(_run_child(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])))
