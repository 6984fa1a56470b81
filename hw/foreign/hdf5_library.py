"""HDF5 files opened, with what goes wrong said in one line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
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


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a file for reading. Raises ``InvalidSource``."""
    try:
        file = library().File(path, "r")
    except (OSError, RuntimeError, ValueError) as fault:
        raise InvalidSource(f"{path} is no HDF5 file that can be read: is it whole, is it HDF5?") from fault
    with file:
        yield file
