"""Files of other programs, told by their names, in place of a device."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path

from hw.common.errors import InvalidSource
from hw.common.limits import ReadLimits
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


def tells_itself(path: Path, limits: ReadLimits) -> bool:
    """Whether a file is a recording of this project, by its name or, if it is HDF5, by its contents; raises ``InvalidSource``."""
    if path.suffix.lower() not in HDF5:
        return not is_foreign(path)
    from hw.foreign.hdf5_file import Hdf5File
    from hw.foreign.hdf5_recording import is_recording

    with Hdf5File(path, limits) as file:
        return is_recording(file)


def replayed(path: Path, columns: ColumnMap, limits: ReadLimits) -> Transport:
    """Return the source of a file's samples.

    Args:
        path: ends in .csv, .txt, .tsv, .dat, .wav, .h5 or .hdf5.
        columns: what is known beside.
        limits: memory and time that an HDF5 file may take, whose few bytes can claim any number of samples.

    Raises:
        InvalidSource: it cannot be read, or something is missing.
    """
    if not os.path.isfile(path):
        left = f"; what was read until it was interrupted is in {raw_beside(path)}" if raw_beside(path).exists() else ""
        raise InvalidSource(f"{path} cannot be read: there is no such file{left}")
    suffix = path.suffix.lower()
    if suffix in HDF5:
        return _hdf5_transport(path, columns, limits)
    if suffix in WAV:
        from hw.foreign.wav_table import read_wav

        return TableTransport(read_wav(path), columns)
    from hw.foreign.csv_table import read_csv

    return TableTransport(read_csv(path), columns)


def _hdf5_transport(path: Path, columns: ColumnMap, limits: ReadLimits) -> Transport:
    """Return the source of an HDF5 file's samples: a recording of this project is read chunk by chunk, a table at once."""
    from hw.foreign.hdf5_file import Hdf5File
    from hw.foreign.hdf5_recording import Hdf5Replay, is_recording
    from hw.foreign.hdf5_table import table_of

    with ExitStack() as stack:
        file = stack.enter_context(Hdf5File(path, limits))
        if not is_recording(file):
            return TableTransport(table_of(file, limits), columns)
        if columns != ColumnMap():
            raise InvalidSource(f"{path} tells its columns and its rate itself: allowed: no --column and no --rate")
        replay = Hdf5Replay(file, limits)
        stack.pop_all()  # open until the transport is closed
        return replay
