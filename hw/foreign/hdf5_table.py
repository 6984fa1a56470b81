"""Read HDF5 files of other programs as tables: a 1-D dataset is a column, a matrix gives one for each of its columns."""

from __future__ import annotations

import numpy as np

from hw.common.limits import ReadLimits
from hw.common.samples import Floats
from hw.foreign.hdf5_file import Hdf5File
from hw.foreign.table import ColumnTable
from hw.foreign.units import build_refusal

RATE_ATTRIBUTES = ("rate", "sample_rate", "sampling_rate", "SampleRate", "fs")
MAX_MATRIX_COLUMNS = 16  # a wider matrix is a picture, not channels


def build_table(file: Hdf5File, limits: ReadLimits) -> ColumnTable:
    """Build a table of an HDF5 file; columns are named ``group/name``, or ``group/name[1]`` in a matrix.

    Parameters
    ----------
    file
        Must stay open until the table is read.
    limits
        Of memory and time.

    Raises
    ------
    InvalidSource
        The file holds no columns of numbers.
    """
    columns: list[tuple[str, str, int | None, str]] = []
    for dataset in file.datasets.values():
        if len(dataset.shape) == 1:
            columns.append((dataset.path, dataset.path, None, dataset.unit))
        elif dataset.shape[1] <= MAX_MATRIX_COLUMNS:
            columns.extend((f"{dataset.path}[{k + 1}]", dataset.path, k, dataset.unit) for k in range(dataset.shape[1]))
    name = file.path.name
    if not columns:
        raise build_refusal(name, "no columns of numbers", "an HDF5 file with datasets of one or two dimensions")

    def read(wanted: list[int]) -> Floats:
        lengths = {columns[k][0]: file.datasets[columns[k][1]].shape[0] for k in wanted}
        if len(set(lengths.values())) > 1:
            raise build_refusal(name, f"columns of {lengths}", "the same number of samples in each")
        if unwritten := [columns[k][0] for k in wanted if not file.datasets[columns[k][1]].written]:
            raise build_refusal(name, f"{unwritten[0]}, which was never written", "columns that hold samples")
        limits.check_values(name, sum(lengths.values()))  # before reading: a few bytes can claim any number
        return np.stack(file.read([columns[k][1:3] for k in wanted]), axis=1).astype(float, copy=False)

    names, _, _, units = zip(*columns, strict=True)
    return ColumnTable(name, names, units, read, _read_rate(file), source={"transport": "hdf5"})


def _read_rate(file: Hdf5File) -> float | None:
    """Return the rate in Hz that the file states, or None."""
    stated = [file.attributes[key] for key in RATE_ATTRIBUTES if key in file.attributes]
    rates = [float(value) for value in stated if not isinstance(value, str) and value > 0]
    return rates[0] if rates else None
