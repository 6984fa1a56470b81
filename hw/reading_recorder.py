"""Write a reading to disk: raw bytes, or HDF5 with the raw bytes next to it until it is complete."""

from __future__ import annotations

from pathlib import Path

from hw.common.samples import Samples
from hw.common.transport import Chunk, Header
from hw.files.hdf5_recorder import Hdf5Recorder
from hw.files.open_file import HDF5_SUFFIXES, raw_recording_path
from hw.recordings.recording import Recorder


class ReadingRecorder:
    """Record each chunk before it is decoded, and for a name that ends in .h5 then the decoded samples.

    A kill or a full disk destroys an HDF5 file, but not the raw bytes next to it, which are removed once it is complete. A
    replayed source is in a file already, so that its raw bytes are not written beside HDF5.

    Parameters
    ----------
    path
        Of the new file; the name of an HDF5 file's raw recording is this name with ``.probe`` appended.
    header
        Of the source.

    Raises
    ------
    FileExistsError
        One of the files exists.
    OSError
        The raw recording cannot be written; of HDF5 ``close`` raises it, so that the reading goes on.
    """

    def __init__(self, path: Path, header: Header) -> None:
        """Create the files; if only the raw recording cannot be written, the HDF5 file is discarded."""
        is_hdf5 = path.suffix.lower() in HDF5_SUFFIXES
        self._raw_path = raw_recording_path(path) if is_hdf5 else path
        self._hdf5 = Hdf5Recorder(path, header) if is_hdf5 else None
        self._raw: Recorder | None = None
        self._fault: OSError | None = None  # of either file: HDF5 is not completed then
        if self._hdf5 is not None and "replayed" in header.source:
            return
        try:
            self._raw = Recorder(self._raw_path, header)
        except OSError as fault:
            if self._hdf5 is not None:
                self._hdf5.discard()
            if self._hdf5 is None or isinstance(fault, FileExistsError):
                raise
            self._fault = fault

    @property
    def failure_text(self) -> str:
        """What remains of the recording if it fails, as text."""
        if self._hdf5 is None:
            return "the recording ends early, whole up to there"
        return "there is no HDF5 file" + (f", but what was read is in {self._raw_path.name}" if self._raw_path.exists() else "")

    def write(self, chunk: Chunk) -> None:
        """Write a chunk's raw bytes. Raises ``OSError`` if the disk fails; the raw recording is then readable up to there."""
        if self._raw is None:
            return
        try:
            self._raw.write(chunk)
        except OSError as fault:
            self._fault = fault
            raise

    def write_samples(self, samples: Samples) -> None:
        """Add samples to the HDF5 file, if there is one and its disk has not failed."""
        if self._hdf5 is None or self._fault is not None:
            return
        try:
            self._hdf5.write_samples(samples)
        except OSError as fault:  # the raw bytes go on
            self._fault = fault
            self._hdf5.discard()

    def close(self) -> None:
        """Complete the recording.

        Raises
        ------
        OSError
            The HDF5 file could not be written; the raw bytes stay.
        """
        if self._raw is not None:
            self._raw.close()
        if self._hdf5 is None:
            return
        try:
            if self._fault is not None:
                raise self._fault
            self._hdf5.close()
        finally:
            self._hdf5.discard()
        if self._raw is not None:
            self._raw_path.unlink()
