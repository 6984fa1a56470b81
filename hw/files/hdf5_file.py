"""Read HDF5 files of unknown origin in a child process with limits of memory and time: see `hdf5_program`.

A 1-D dataset is a column, a matrix gives one for each of its columns.
"""

from __future__ import annotations

import math
import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from hw.common.closing import Closing
from hw.common.errors import InvalidSource
from hw.common.limits import ReadLimits
from hw.common.samples import Floats
from hw.files.columns import build_refusal
from hw.files.table import ColumnTable

READER_PROGRAM = Path(__file__).with_name("hdf5_program.py")
RATE_ATTRIBUTES = ("rate", "sample_rate", "sampling_rate", "SampleRate", "fs")
MAX_MATRIX_COLUMNS = 16  # a wider matrix is a picture, not channels


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
    is_written
        Whether any value is stored: HDF5 returns zeros for values that were never written.
    """

    path: str
    shape: tuple[int, ...]
    unit: str
    is_written: bool


class Hdf5File(Closing):
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

    Raises
    ------
    InvalidSource
        The file is not HDF5, is damaged, refers to data outside itself, or exceeds a limit.
    """

    def __init__(self, path: Path, limits: ReadLimits) -> None:
        """Start the process, and read the description of the file from it."""
        self.path, self._limits, self._end = path, limits, time.monotonic() + limits.seconds
        arguments = [str(READER_PROGRAM), os.path.abspath(path), str(int(limits.memory)), str(math.ceil(limits.seconds))]
        self._process = subprocess.Popen(
            [sys.executable, "-P", *arguments],  # -P: no module of the program's folder hides a library
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=_build_environment(),
        )
        self._timer = threading.Timer(limits.seconds, self._process.kill)  # its pipe then ends
        self._timer.daemon = True
        self._timer.start()
        try:
            description = self._receive()
        except BaseException:
            self.close()
            raise
        self.attributes: dict[str, Any] = description["attributes"]
        self.datasets = {entry["path"]: Dataset(**entry) for entry in description["datasets"]}

    def read(self, columns: Sequence[tuple[str, int | None]]) -> list[NDArray[Any]]:
        """Return columns, each given by its dataset's path and a matrix column or None; floats are doubles.

        Raises
        ------
        InvalidSource
            They cannot be read within the limits.
        """
        with suppress(OSError):  # that the process has ended shows in _receive
            stdin: IO[bytes] = self._process.stdin  # type: ignore[assignment] # a pipe was asked for
            pickle.dump(list(columns), stdin)
            stdin.flush()
        arrays: list[NDArray[Any]] = self._receive()
        return arrays

    def build_table(self) -> ColumnTable:
        """Return the file as a table, whose columns are named ``group/name``, or ``group/name[1]`` in a matrix.

        The file must stay open until the table is read.

        Raises
        ------
        InvalidSource
            The file holds no columns of numbers.
        """
        columns: list[tuple[str, Dataset, int | None]] = []
        for dataset in self.datasets.values():
            if len(dataset.shape) == 1:
                columns.append((dataset.path, dataset, None))
            elif dataset.shape[1] <= MAX_MATRIX_COLUMNS:
                columns.extend((f"{dataset.path}[{k + 1}]", dataset, k) for k in range(dataset.shape[1]))
        if not columns:
            raise build_refusal(self.path.name, "no columns of numbers", "an HDF5 file with datasets of one or two dimensions")

        def read(numbers: list[int]) -> Floats:
            """Return the columns of these indices, shape (rows, columns)."""
            wanted = [columns[number] for number in numbers]
            self._check_columns(wanted)
            return np.stack(self.read([(dataset.path, k) for _, dataset, k in wanted]), axis=1).astype(float, copy=False)

        names, units = tuple(name for name, _, _ in columns), tuple(dataset.unit for _, dataset, _ in columns)
        return ColumnTable(self.path.name, names, units, read, self._find_rate(), source={"transport": "hdf5"})

    def _check_columns(self, columns: Sequence[tuple[str, Dataset, int | None]]) -> None:
        """Refuse columns of different lengths, columns without stored values, and columns too large for the memory.

        The size is checked before it is read, since a few bytes of HDF5 can claim any number of values. Each column is given by
        its name, dataset and, in a matrix, index.
        """
        lengths = {name: dataset.shape[0] for name, dataset, _ in columns}
        if len(set(lengths.values())) > 1:
            raise build_refusal(self.path.name, f"columns of {lengths}", "the same number of samples in each")
        for name, dataset, _ in columns:
            if not dataset.is_written:
                raise build_refusal(self.path.name, f"{name}, which was never written", "columns that hold samples")
        self._limits.check_values(self.path.name, sum(lengths.values()))

    def _find_rate(self) -> float | None:
        """Return the rate in Hz that the file states by one of RATE_ATTRIBUTES, or None."""
        values = [self.attributes[key] for key in RATE_ATTRIBUTES if key in self.attributes]
        return next((float(value) for value in values if not isinstance(value, str) and value > 0), None)

    def close(self) -> None:
        """End the process."""
        self._timer.cancel()
        self._process.kill()
        with self._process:  # closes its pipes and waits for its end
            pass

    def _receive(self) -> Any:
        """Return the next reply of the process; a text is the reason of a refusal. Raises ``InvalidSource``."""
        stdout: IO[bytes] = self._process.stdout  # type: ignore[assignment] # a pipe was asked for
        try:
            reply = pickle.load(stdout)
        except (EOFError, pickle.UnpicklingError):  # the process has ended
            self._process.wait()
            reply = "is damaged: the HDF5 library fails on it"
            if time.monotonic() >= self._end:
                reply = f"takes longer than {self._limits.seconds:g} s to read: --time raises the limit"
        if isinstance(reply, str):
            raise InvalidSource(f"{self.path} {reply}")
        return reply


def _build_environment() -> dict[str, str]:
    """Return the child's environment: one thread, this process's modules, and no HDF5 plugins that a file could load."""
    path = os.pathsep.join(os.path.abspath(entry) for entry in sys.path if entry)
    settings = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": path, "HDF5_PLUGIN_PRELOAD": "::"}
    return {**os.environ, **settings, "PYTHONWARNINGS": "ignore"}
