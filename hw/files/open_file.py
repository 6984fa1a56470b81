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


def is_from_other_program(path: Path) -> bool:
    """Whether a file's suffix is that of another program's files."""
    return path.suffix.lower() in (*HDF5_SUFFIXES, *TEXT_SUFFIXES, *WAV_SUFFIXES)


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
        raise InvalidSource(f"{path} cannot be read: there is no such file")
    if path.suffix.lower() in WAV_SUFFIXES:
        return convert_table(read_wav(path), columns)
    if path.suffix.lower() not in HDF5_SUFFIXES:
        return convert_table(read_csv(path), columns)
    with Hdf5File(path, limits) as file:
        return convert_table(file.build_table(), columns)
