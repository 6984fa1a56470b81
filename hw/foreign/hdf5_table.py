"""HDF5 files of other programs: each dataset of one dimension is a column, each column of a matrix another."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hw.common.samples import Floats
from hw.foreign.hdf5_library import opened
from hw.foreign.table import ColumnTable
from hw.foreign.units import refusal

UNITS = ("units", "unit", "Units", "Unit")
RATES = ("rate", "sample_rate", "sampling_rate", "SampleRate", "fs")
MOST_COLUMNS = 200
MOST_VALUES = 100_000_000


def read_hdf5(path: Path) -> ColumnTable:
    """Read an HDF5 file; names of columns are the datasets' paths, ``group/name`` and ``group/name[1]`` for a matrix.

    Raises:
        InvalidSource: it cannot be read, or holds no columns of numbers.
    """
    with opened(path) as file:
        columns = _columns(file)
        rates = [float(value) for key in RATES if (value := _number(file.attrs.get(key))) is not None and value > 0]
    if not columns:
        raise refusal(path.name, "no columns of numbers", "an HDF5 file with datasets of one or two dimensions")

    def read(wanted: list[int]) -> Floats:
        with opened(path) as file:
            if sum(file[columns[k][1]].shape[0] for k in wanted) > MOST_VALUES:  # a few bytes may claim any number
                raise refusal(path.name, "columns of too many samples", f"{MOST_VALUES} together, a gigabyte")
            found = [_values(file[columns[k][1]], columns[k][2]) for k in wanted]
        lengths = {columns[k][0]: len(values) for k, values in zip(wanted, found, strict=True)}
        if len(set(lengths.values())) > 1:
            raise refusal(path.name, f"columns of {lengths}", "the same number of samples in each")
        return np.stack(found, axis=1)

    names, _, _, units = zip(*columns, strict=True)
    return ColumnTable(path.name, names, units, read, rates[0] if rates else None, source={"transport": "hdf5"})


def _columns(file: Any) -> list[tuple[str, str, int | None, str]]:
    """Name, path and column of what may be samples, with its unit."""
    found: list[tuple[str, str, int | None, str]] = []

    def look(path: str, node: Any) -> None:
        if not hasattr(node, "shape") or node.shape is None or node.dtype.kind not in "iuf" or len(found) > MOST_COLUMNS:
            return
        unit = next((_word(node.attrs[key]) for key in UNITS if key in node.attrs), "")
        if len(node.shape) == 1:
            found.append((path, path, None, unit))
        elif len(node.shape) == 2 and node.shape[1] <= 16:
            found.extend((f"{path}[{k + 1}]", path, k, unit) for k in range(node.shape[1]))

    file.visititems(look)
    return found


def _values(dataset: Any, column: int | None) -> Floats:
    return np.asarray(dataset[:] if column is None else dataset[:, column], dtype=float)


def _number(value: Any) -> float | None:
    try:
        return None if value is None else float(np.asarray(value).reshape(-1)[0])
    except (TypeError, ValueError, IndexError):
        return None


def _word(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
