"""Limit the memory and the time that reading a file may take."""

from __future__ import annotations

from dataclasses import dataclass

from hw.common.errors import InvalidSource

LIBRARY_MEMORY_BYTES = 0.25e9  # bytes of a process that has loaded numpy and h5py, measured on Linux
BYTES_PER_VALUE = 60  # peak memory per number of a column, measured with 1e7 rows of two columns


@dataclass(frozen=True)
class ReadLimits:
    """Limits of reading one file.

    Attributes
    ----------
    memory
        Bytes, the libraries' own included.
    seconds
        From opening to the last sample.
    """

    memory: float = 2e9
    seconds: float = 120.0

    def check_values(self, name: str, values: int) -> None:
        """Refuse a file whose columns claim more values than the memory can hold.

        Parameters
        ----------
        name
            Of the file, for the message.
        values
            Numbers in all columns that are read.

        Raises
        ------
        InvalidSource
            They need more than ``memory``.
        """
        needed = values * BYTES_PER_VALUE + LIBRARY_MEMORY_BYTES
        if needed > self.memory:
            takes = f"{name} claims {values:.3g} samples, which take {needed / 1e9:.2g} GB to read"
            raise InvalidSource(f"{takes}: allowed: up to {self.memory / 1e9:g} GB; --memory raises the limit")
