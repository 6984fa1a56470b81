"""The HDF5 library where it is installed, and files that it writes to disks that may be full."""

from __future__ import annotations

import os
from importlib import import_module
from io import FileIO
from typing import Any

from hw.common.errors import InvalidSource


def library() -> Any:
    """Return h5py, which who reads no HDF5 need not wait for.

    Raises:
        InvalidSource: it is not installed.
    """
    try:
        return import_module("h5py")
    except ImportError as missing:
        raise InvalidSource("HDF5 files need h5py: pip install h5py") from missing


class UnfailingFile(FileIO):
    """A new file's bytes for h5py, which a full disk never fails; ``fault`` is then what the disk said, and the file worthless.

    HDF5 cannot close a file after a write that failed, tries again when the program ends, and takes it down.
    """

    fault: OSError | None = None

    def write(self, data: Any) -> int:
        """Write all of it; after a fault, nothing."""
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
        """Give it a length; after a fault, none."""
        try:
            return super().truncate(size) if self.fault is None else self.tell()
        except OSError as fault:
            self.fault = fault
            return self.tell()
