"""Load the HDF5 library, and give it files that survive a full disk."""

from __future__ import annotations

import os
from importlib import import_module
from io import FileIO
from typing import Any

from hw.common.errors import InvalidSource


def load_h5py() -> Any:
    """Import and return h5py; only programs that read or write HDF5 load it.

    Raises
    ------
    InvalidSource
        h5py is not installed.
    """
    try:
        return import_module("h5py")
    except ImportError as missing:
        raise InvalidSource("HDF5 files need h5py: pip install h5py") from missing


class UnfailingFile(FileIO):
    """A new file for h5py whose writes never fail; after an error of the disk ``fault`` holds it, and the file is invalid.

    HDF5 cannot close a file after a failed write. It tries again when the program ends, and crashes it.
    """

    fault: OSError | None = None

    def write(self, data: Any) -> int:
        """Write all bytes; after a fault, write nothing and report success."""
        left = memoryview(data).cast("B")
        size = len(left)
        try:
            while left and self.fault is None:
                left = left[super().write(left) :]
        except OSError as fault:
            self.fault = fault
        self.seek(len(left), os.SEEK_CUR)
        return size

    def truncate(self, size: int | None = None) -> int:
        """Set the file's length; after a fault, do nothing."""
        try:
            return super().truncate(size) if self.fault is None else self.tell()
        except OSError as fault:
            self.fault = fault
            return self.tell()
