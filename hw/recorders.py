"""Write a reading to disk: raw bytes, or HDF5 with the raw bytes next to it until it is complete."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from hw.common.samples import Samples
from hw.common.transport import Chunk, Header
from hw.files.hdf5_recorder import Hdf5Recorder
from hw.files.open_file import HDF5_SUFFIXES, raw_recording_path
from hw.recordings.recording import Recorder


class DataRecorder(Protocol):
    """The interface of a recorder: it takes each chunk before it is decoded, and then the decoded samples."""

    @property
    def failure_text(self) -> str:
        """What remains of the recording if it fails, as text."""
        ...

    def write(self, chunk: Chunk) -> None:
        """Write a chunk's raw bytes. Raises ``OSError``."""
        ...

    def write_samples(self, samples: Samples) -> None:
        """Write samples. Raises ``OSError``."""
        ...

    def close(self) -> None:
        """Complete the recording. Raises ``OSError``."""
        ...


def open_recorder(path: Path | str, header: Header) -> DataRecorder:
    """Open a recorder for a new file, HDF5 if its suffix says so. Raises ``FileExistsError`` or another ``OSError``."""
    return GuardedHdf5(Path(path), header) if Path(path).suffix.lower() in HDF5_SUFFIXES else RawRecorder(path, header)


class RawRecorder(Recorder):
    """A recorder of the raw bytes only."""

    failure_text = "the recording ends early, whole up to there"

    def write_samples(self, samples: Samples) -> None:
        """Do nothing: the samples follow from the bytes."""


class GuardedHdf5:
    """A recorder of HDF5, guarded by a raw recording: a kill or a full disk destroys the HDF5 file, but not the raw bytes.

    A replayed source is in a file already, so that its raw bytes are not written again. Faults are raised by ``close``.

    Parameters
    ----------
    path
        Of the new file; the raw recording's name is this name with ``.probe`` appended.
    header
        Of the source.

    Raises
    ------
    FileExistsError
        One of the two files exists.
    """

    def __init__(self, path: Path, header: Header) -> None:
        self._path = raw_recording_path(path)
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
    def failure_text(self) -> str:
        """What remains of the recording if it fails, as text."""
        return "there is no HDF5 file" + (f", but what was read is in {self._path.name}" if self._path.exists() else "")

    def write(self, chunk: Chunk) -> None:
        """Write a chunk's raw bytes. On a full disk the raw recording ends, readable up to there."""
        if self._raw is None:
            return
        try:
            self._raw.write(chunk)
        except OSError as fault:
            self._fault = self._fault or fault
            self._raw.close()
            self._raw = None

    def write_samples(self, samples: Samples) -> None:
        """Write samples. On a full disk the HDF5 file is discarded in favour of the raw bytes."""
        if self._fault is not None:
            return
        try:
            self._samples.write_samples(samples)
        except OSError as fault:
            self._fault = fault
            self._samples.discard()

    def close(self) -> None:
        """Complete the HDF5 file, and then remove the raw bytes.

        Raises
        ------
        OSError
            The HDF5 file could not be written; the raw bytes stay.
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
