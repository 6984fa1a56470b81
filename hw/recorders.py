"""What takes a reading's data to disk: raw bytes, or HDF5 with the raw bytes beside it until it is whole."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from hw.common.samples import Samples
from hw.common.transport import Chunk, Header
from hw.foreign.files import HDF5, raw_beside
from hw.foreign.hdf5_recording import Hdf5Recorder
from hw.recordings.recording import Recorder


class DataRecorder(Protocol):
    """Takes what was read, chunk by chunk before it is decoded, and the samples that came of it."""

    @property
    def ended(self) -> str:
        """What is left of the recording where it fails, in words."""
        ...

    def write(self, chunk: Chunk) -> None:
        """Take raw bytes. Raises ``OSError``."""
        ...

    def write_samples(self, samples: Samples) -> None:
        """Take samples. Raises ``OSError``."""
        ...

    def close(self) -> None:
        """End it. Raises ``OSError``."""
        ...


def recorder_of(path: Path | str, header: Header) -> DataRecorder:
    """Return what writes a new file, HDF5 where its name ends so. Raises ``FileExistsError`` or another ``OSError``."""
    return GuardedHdf5(Path(path), header) if Path(path).suffix.lower() in HDF5 else RawRecorder(path, header)


class RawRecorder(Recorder):
    """Raw bytes alone."""

    ended = "the recording ends early, whole up to there"

    def write_samples(self, samples: Samples) -> None:
        """Nothing: they follow from the bytes."""


class GuardedHdf5:
    """HDF5, of which a kill or a full disk leaves nothing, and beside it the raw bytes, of which all that came is left.

    What is replayed stands in a file already, and is not written once more. Faults are told when it is closed.

    Args:
        path: of the new file; the raw bytes' has ``.probe`` behind it.
        header: of the source.

    Raises:
        FileExistsError: there is a file of one of the names.
    """

    def __init__(self, path: Path, header: Header) -> None:
        self._path = raw_beside(path)
        self._fault: OSError | None = None
        self._samples = Hdf5Recorder(path, header)
        self._raw: Recorder | None = None
        try:
            self._raw = None if "replayed" in header.source else Recorder(self._path, header)
        except FileExistsError:
            self._samples.discard()
            raise
        except OSError as fault:
            self._fault = fault

    @property
    def ended(self) -> str:
        """What is left."""
        return "there is no HDF5 file" + (f", but what was read is in {self._path.name}" if self._path.exists() else "")

    def write(self, chunk: Chunk) -> None:
        """Take raw bytes; where the disk is full, the raw recording ends, whole up to there."""
        if self._raw is None:
            return
        try:
            self._raw.write(chunk)
        except OSError as fault:
            self._fault = self._fault or fault
            self._raw.close()
            self._raw = None

    def write_samples(self, samples: Samples) -> None:
        """Take samples; where the disk is full, HDF5 makes room for the raw bytes."""
        if self._fault is not None:
            return
        try:
            self._samples.write_samples(samples)
        except OSError as fault:
            self._fault = fault
            self._samples.discard()

    def close(self) -> None:
        """Make the HDF5 file whole, and then remove the raw bytes.

        Raises:
            OSError: it could not be made; the raw bytes stay.
        """
        try:
            if self._fault is not None:
                self._samples.discard()
                raise self._fault
            self._samples.close()
        finally:
            if self._raw is not None:
                self._raw.close()
        if self._raw is not None:
            self._path.unlink()
