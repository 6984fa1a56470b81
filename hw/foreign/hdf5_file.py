"""Read HDF5 files of unknown origin in a child process with limits of memory and time: see `hdf5_program`."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from hw.common.errors import InvalidSource
from hw.common.limits import ReadLimits
from hw.foreign.hdf5_library import load_h5py

READER_PROGRAM = Path(__file__).with_name("hdf5_program.py")


@dataclass(frozen=True)
class Dataset:
    """The description of a dataset of numbers; its data are not read yet.

    Attributes
    ----------
    path
        Within the file, ``group/name``.
    shape
        Of one or two dimensions.
    unit
        As text; empty where none is stated.
    whole
        Whether all its values are stored, uncompressed: HDF5 returns zeros for values that were never written.
    written
        Whether any value is stored.
    """

    path: str
    shape: tuple[int, ...]
    unit: str
    whole: bool
    written: bool


class Hdf5File:
    """An HDF5 file, read by a child process; a context manager that ends the process.

    Parameters
    ----------
    path
        Of the file.
    limits
        Memory and time for all requests together.

    Attributes
    ----------
    attributes
        Texts and numbers of the file's root.
    datasets
        Descriptions by path.
    gaps
        (first, count, reason) if the file is a recording of this project.

    Raises
    ------
    InvalidSource
        The file is not HDF5, is damaged, refers to data outside itself, exceeds a limit, or h5py is missing.
    """

    def __init__(self, path: Path, limits: ReadLimits) -> None:
        load_h5py()  # raises with an installation hint before the child process would fail
        self.path, self._limits, self._end = path, limits, time.monotonic() + limits.seconds
        command = [
            sys.executable,
            "-P",
            str(READER_PROGRAM),
            os.path.abspath(path),
            str(int(limits.memory)),
            str(math.ceil(limits.seconds)),
        ]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=_build_environment()
        )
        try:
            description, _ = self._receive()
        except BaseException:
            self.close()
            raise
        self.attributes: dict[str, Any] = description["attributes"]
        self.datasets = {entry["path"]: Dataset(**entry | {"shape": tuple(entry["shape"])}) for entry in description["datasets"]}
        self.gaps = [(int(first), int(count), str(reason)) for first, count, reason in description["gaps"]]

    def read(
        self, datasets: Sequence[tuple[str, int | None]], begin: int = 0, end: int | None = None
    ) -> list[NDArray[np.float64 | np.int64 | np.uint8]]:
        """Return rows ``begin`` to ``end`` of datasets, each given by its path and a matrix column or None.

        Raises
        ------
        InvalidSource
            The rows cannot be read within the limits.
        """
        request = {"datasets": list(datasets), "begin": begin, "end": end}
        with suppress(OSError):  # that the process has ended shows in _receive
            stdin: IO[bytes] = self._process.stdin  # type: ignore[assignment] # a pipe was asked for
            stdin.write(json.dumps(request).encode() + b"\n")
            stdin.flush()
        return self._receive()[1]

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        with self._process:  # closes its pipes and waits for its end
            pass

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _receive(self) -> tuple[dict[str, Any], list[NDArray[Any]]]:
        stdout: IO[bytes] = self._process.stdout  # type: ignore[assignment] # a pipe was asked for
        with self._limit_time():
            line = stdout.readline()
            reply: dict[str, Any] = json.loads(line) if line.endswith(b"\n") else {"refused": self._explain_end()}
            if "refused" in reply:
                raise InvalidSource(f"{self.path} {reply['refused']}")
            arrays = [_read_array(stdout, np.dtype(kind), tuple(shape)) for kind, shape in reply.get("arrays", [])]
        if any(array is None for array in arrays):
            raise InvalidSource(f"{self.path} {self._explain_end()}")
        return reply, [array for array in arrays if array is not None]

    @contextmanager
    def _limit_time(self) -> Iterator[None]:
        """Kill the process when the time limit is reached; its pipe then ends."""
        timer = threading.Timer(max(self._end - time.monotonic(), 0.0), self._process.kill)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()

    def _explain_end(self) -> str:
        """Explain why the process ended without a reply."""
        self._process.wait()
        if time.monotonic() >= self._end:
            return f"takes longer than {self._limits.seconds:g} s to read: --time raises the limit"
        return "is damaged: the HDF5 library fails on it"


def _read_array(stream: IO[bytes], kind: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any] | None:
    """Read an array from a stream; return None if the stream ends too early."""
    array = np.empty(shape, kind)
    view = array.data.cast("B") if array.size else memoryview(b"")
    while view:
        count = stream.readinto(view)  # type: ignore[attr-defined] # of a buffered reader
        if not count:
            return None
        view = view[count:]
    return array


def _build_environment() -> dict[str, str]:
    """Return the child's environment: one thread, this process's modules, and no HDF5 plugins that a file could load."""
    path = os.pathsep.join(os.path.abspath(entry) for entry in sys.path if entry)
    settings = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": path, "HDF5_PLUGIN_PRELOAD": "::"}
    return {**os.environ, **settings, "PYTHONWARNINGS": "ignore"}
