"""Files of other programs, told by their names, in place of a device."""

from __future__ import annotations

import os
from pathlib import Path

from hw.common.errors import InvalidSource
from hw.common.transport import Transport
from hw.foreign.columns import ColumnMap
from hw.foreign.table import TableTransport

HDF5 = (".h5", ".hdf5")
TEXT = (".csv", ".txt", ".tsv", ".dat")
WAV = (".wav",)


def raw_beside(path: Path) -> Path:
    """Return the file that holds the raw bytes of an HDF5 recording until that is whole, and after a kill."""
    return path.with_name(f"{path.name}.probe")


def is_foreign(path: Path) -> bool:
    """Whether a file's name ends as those of other programs' files."""
    return path.suffix.lower() in (*HDF5, *TEXT, *WAV)


def tells_itself(path: Path) -> bool:
    """Whether a file is a recording of ours, by its name or, if it is HDF5, by what it says; raises ``InvalidSource``."""
    if path.suffix.lower() not in HDF5:
        return not is_foreign(path)
    from hw.foreign.hdf5_recording import ours

    return ours(path)


def replayed(path: Path, columns: ColumnMap) -> Transport:
    """Return the source of a file's samples.

    Args:
        path: ends in .csv, .txt, .tsv, .dat, .wav, .h5 or .hdf5.
        columns: what is known beside.

    Raises:
        InvalidSource: it cannot be read, or something is missing.
    """
    if not os.path.isfile(path):
        left = f"; what was read until it was interrupted is in {raw_beside(path)}" if raw_beside(path).exists() else ""
        raise InvalidSource(f"{path} cannot be read: there is no such file{left}")
    suffix = path.suffix.lower()
    if suffix in HDF5:
        from hw.foreign.hdf5_recording import Hdf5Replay, ours
        from hw.foreign.hdf5_table import read_hdf5

        if ours(path):
            if columns != ColumnMap():
                raise InvalidSource(f"{path} tells its columns and its rate itself: allowed: no --column and no --rate")
            return Hdf5Replay(path)
        return TableTransport(read_hdf5(path), columns)
    if suffix in WAV:
        from hw.foreign.wav_table import read_wav

        return TableTransport(read_wav(path), columns)
    from hw.foreign.csv_table import read_csv

    return TableTransport(read_csv(path), columns)
