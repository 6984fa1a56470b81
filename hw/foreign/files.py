"""Open files of other programs, recognised by their suffix, as transports."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path

from hw.common.errors import InvalidSource
from hw.common.limits import ReadLimits
from hw.common.transport import Transport
from hw.foreign.columns import ColumnMap
from hw.foreign.csv_table import read_csv
from hw.foreign.table import TableTransport
from hw.foreign.wav_table import read_wav

HDF5_SUFFIXES = (".h5", ".hdf5")
TEXT_SUFFIXES = (".csv", ".txt", ".tsv", ".dat")
WAV_SUFFIXES = (".wav",)


def raw_recording_path(path: Path) -> Path:
    """Return the path of the raw bytes of an HDF5 recording: the file exists until the recording is complete, or after a kill."""
    return path.with_name(f"{path.name}.probe")


def is_foreign(path: Path) -> bool:
    """Whether a file's suffix is that of another program's files."""
    return path.suffix.lower() in (*HDF5_SUFFIXES, *TEXT_SUFFIXES, *WAV_SUFFIXES)


def is_self_describing(path: Path, limits: ReadLimits) -> bool:
    """Whether a file is a recording of this project, by its suffix or, for HDF5, by its contents. Raises ``InvalidSource``."""
    if path.suffix.lower() not in HDF5_SUFFIXES:
        return not is_foreign(path)
    from hw.foreign.hdf5_file import Hdf5File
    from hw.foreign.hdf5_recording import is_recording

    with Hdf5File(path, limits) as file:
        return is_recording(file)


def open_file(path: Path, columns: ColumnMap, limits: ReadLimits) -> Transport:
    """Open a file as a source of samples.

    Parameters
    ----------
    path
        Ends in .csv, .txt, .tsv, .dat, .wav, .h5 or .hdf5.
    columns
        The user's information on its columns.
    limits
        Memory and time for an HDF5 file, whose few bytes can claim any number of samples.

    Raises
    ------
    InvalidSource
        The file cannot be read, or information is missing.
    """
    if not os.path.isfile(path):
        hint = (
            f"; what was read until it was interrupted is in {raw_recording_path(path)}"
            if raw_recording_path(path).exists()
            else ""
        )
        raise InvalidSource(f"{path} cannot be read: there is no such file{hint}")
    suffix = path.suffix.lower()
    if suffix in HDF5_SUFFIXES:
        return _open_hdf5(path, columns, limits)
    if suffix in WAV_SUFFIXES:
        return TableTransport(read_wav(path), columns)

    return TableTransport(read_csv(path), columns)


def _open_hdf5(path: Path, columns: ColumnMap, limits: ReadLimits) -> Transport:
    """Open an HDF5 file: a recording of this project is read chunk by chunk, a table of another program at once."""
    from hw.foreign.hdf5_file import Hdf5File
    from hw.foreign.hdf5_recording import Hdf5Replay, is_recording
    from hw.foreign.hdf5_table import build_table

    with ExitStack() as stack:
        file = stack.enter_context(Hdf5File(path, limits))
        if not is_recording(file):
            return TableTransport(build_table(file, limits), columns)
        if columns != ColumnMap():
            raise InvalidSource(f"{path} states its columns and its rate itself: allowed: no --column and no --rate")
        replay = Hdf5Replay(file, limits)
        stack.pop_all()  # open until the transport is closed
        return replay
