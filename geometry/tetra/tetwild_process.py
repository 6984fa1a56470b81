"""pytetwild in a process of its own, which can be stopped at any time and whose crash is an error like any other.

The parent runs this very file; surfaces go there and tetrahedra come back through pipes, and its
folder is removed, so that no files are left behind.
"""

from __future__ import annotations

import io
import math
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

LIMIT = 600.0  # seconds
_STOPPED = (-int(signal.SIGINT), 128 + int(signal.SIGINT), 0xC000013A)  # what a process ends with after Ctrl-C
_FAILED = 3  # pytetwild's own exceptions; everything else is a crash
Arrays = Mapping[str, NDArray[Any]]


class Failure(Exception):  # noqa: N818 - what the process says, not yet an error of the toolkit
    """pytetwild gave no mesh; the text says why."""


class TooLong(Failure):
    """pytetwild did not end within the limit."""


def tetrahedralize(arrays: Arrays, limit: float = LIMIT) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Call ``pytetwild.tetrahedralize`` in a child process that takes one core; safe in several threads at a time.

    Args:
        arrays: its arguments by name, arrays or numbers.
        limit: seconds after which the child is ended.

    Returns:
        Points (n, 3) in the unit of the given ones, and tetrahedra (t, 4) in VTK's order.

    Raises:
        TooLong: it took longer than ``limit``.
        Failure: pytetwild fails or its process ends early.
        KeyboardInterrupt: Ctrl-C, here or in the child, which is gone by then.
    """
    with tempfile.TemporaryDirectory(prefix="tetwild-", ignore_cleanup_errors=True) as folder:
        return _run(arrays, limit, folder)


def _run(arrays: Arrays, limit: float, folder: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Start the child in a folder of its own, where pytetwild leaves files of its surfaces, and wait for it."""
    try:
        child = subprocess.Popen(
            [sys.executable, "-P", os.path.abspath(__file__), str(math.ceil(limit))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=_environment(),
            cwd=folder,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    except OSError as fault:
        raise Failure(f"no process can be started for it ({fault})") from fault
    with child:
        try:
            out, stderr = child.communicate(_packed(arrays), timeout=limit)
        except subprocess.TimeoutExpired:
            raise TooLong(f"it took longer than {limit:g} s") from None
        finally:
            child.kill()
            child.wait()
    if child.returncode in _STOPPED:
        raise KeyboardInterrupt
    if child.returncode != 0:
        raise (TooLong if child.returncode == -_alarm() else Failure)(_reason(child.returncode, stderr))
    mesh = _unpacked(out)
    return mesh["points"], mesh["tetrahedra"].astype(np.int64)


def _environment() -> dict[str, str]:
    """The parent's, with one thread and the parent's module path: the child finds the pytetwild that the parent would."""
    path = os.pathsep.join(os.path.abspath(entry) for entry in sys.path if entry)
    return {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": path, "PYTHONWARNINGS": "ignore"}


def _reason(code: int, stderr: bytes) -> str:
    lines = stderr.decode(errors="replace").strip().splitlines()
    last = f": {lines[-1]}" if lines else ""
    if code == _FAILED:
        return last.removeprefix(": ") or "it does not say why"
    if code == -_alarm():
        return "it took too long"
    if code < 0:
        name = next((one.name for one in signal.Signals if one == -code), f"signal {-code}")
        return f"its process was ended by {name}{last}"
    return f"its process ended with code {code:#x}{last}"


def _alarm() -> int:
    return int(getattr(signal, "SIGALRM", 0))


def _packed(arrays: Arrays) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def _unpacked(content: bytes) -> dict[str, NDArray[Any]]:
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        return dict(arrays)


def _child(limit: int) -> int:
    """Read arguments from stdin, write the mesh to stdout, which is closed to pytetwild's own words; return the exit code."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # at once, whatever is running, and without a word
    if hasattr(signal, "alarm"):
        signal.alarm(limit + 5)  # the limit holds even if the parent is killed
    answer = os.fdopen(os.dup(1), "wb")
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    arguments = _unpacked(sys.stdin.buffer.read())
    try:
        options = {name: value if value.ndim else value.item() for name, value in arguments.items()}
        points, tetrahedra = _pytetwild()(**options, num_threads=1, quiet=True, vtk_ordering=True)
    except (ImportError, RuntimeError, TypeError, ValueError) as fault:
        sys.stderr.write(f"{fault}\n")
        return _FAILED
    answer.write(_packed({"points": points, "tetrahedra": tetrahedra}))
    answer.close()
    return 0


def _pytetwild() -> Callable[..., Any]:
    """``pytetwild.tetrahedralize``, without the half second for pyvista if it can do without."""
    sys.modules["pyvista"] = ModuleType("pyvista")
    try:
        from pytetwild.pytetwild import tetrahedralize
    except (ImportError, AttributeError):
        for name in [name for name in sys.modules if name.startswith(("pyvista", "pytetwild"))]:
            del sys.modules[name]
        from pytetwild.pytetwild import tetrahedralize
    function: Callable[..., Any] = tetrahedralize
    return function


if __name__ == "__main__":
    sys.exit(_child(int(sys.argv[1])))
