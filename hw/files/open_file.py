"""Open files of other programs, recognised by their suffix, as transports."""

from __future__ import annotations

import os
from pathlib import Path

from hw.common.errors import InvalidSource
from hw.common.limits import ReadLimits
from hw.common.transport import Transport
from hw.files.columns import ColumnMap
from hw.files.csv_table import read_csv
from hw.files.hdf5_file import Hdf5File
from hw.files.table import convert_table
from hw.files.wav_table import read_wav

HDF5_SUFFIXES = (".h5", ".hdf5")
TEXT_SUFFIXES = (".csv", ".txt", ".tsv", ".dat")
WAV_SUFFIXES = (".wav",)


def raw_recording_path(path: Path) -> Path:
    """Return the path of the file of raw bytes next to an HDF5 recording.

    This file exists until the recording is complete, and stays if the program is killed before.
    """
    return path.with_name(f"{path.name}.probe")


def is_from_other_program(path: Path) -> bool:
    """Whether a file's suffix is that of another program's files."""
    return path.suffix.lower() in (*HDF5_SUFFIXES, *TEXT_SUFFIXES, *WAV_SUFFIXES)


def is_self_describing(path: Path, limits: ReadLimits) -> bool:
    """Whether a file is a recording of this project, by its suffix or, for HDF5, by its contents.

    Raises
    ------
    InvalidSource
        An HDF5 file cannot be read.
    """
    if path.suffix.lower() not in HDF5_SUFFIXES:
        return not is_from_other_program(path)
    with Hdf5File(path, limits) as file:
        return file.is_recording


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
        raw_path = raw_recording_path(path)
        hint = f"; what was read until it was interrupted is in {raw_path}" if raw_path.exists() else ""
        raise InvalidSource(f"{path} cannot be read: there is no such file{hint}")
    if path.suffix.lower() in WAV_SUFFIXES:
        return convert_table(read_wav(path), columns)
    if path.suffix.lower() not in HDF5_SUFFIXES:
        return convert_table(read_csv(path), columns)
    with Hdf5File(path, limits) as file:
        if not file.is_recording:
            return convert_table(file.build_table(), columns)
        if columns != ColumnMap():
            raise InvalidSource(f"{path} states its columns and its rate itself: allowed: no --column and no --rate")
        return file.read_recording()
