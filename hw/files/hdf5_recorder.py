"""Write recordings as HDF5: samples in volts with units, times, gaps, device and digests.

Datasets ``time`` (s), ``inner``, ``outer`` and ``force`` (V; ``time`` is their scale), ``index``, ``saturated`` (rows, channels)
and ``gaps`` (first, count, reason; count -1: unknown). Attributes: ``format``, ``version``, ``rate`` (Hz), ``overruns``
and the source's properties: ``started``, ``serial``, ``firmware``, ``scene_sha256``, ``calibration_sha256``.
"""

from __future__ import annotations

import json
import os
import secrets
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from hw.common.samples import Gap, Samples
from hw.common.transport import Header

FILE_FORMAT, FORMAT_VERSION = "probe-design samples", 1
CHUNK_ROWS = 1 << 15  # rows of a chunk, which has a checksum


class UnfailingFile(FileIO):
    """A new file for h5py whose writes never fail; after an error of the disk ``fault`` holds it, and the file is invalid.

    HDF5 cannot close a file after a failed write. It tries again when the program ends, and crashes it.
    """

    fault: OSError | None = None

    def write(self, data: Any) -> int:
        """Write all bytes; after a fault, write nothing and report success."""
        left = memoryview(data).cast("B")  # bytes not written yet
        size = len(left)
        try:
            while left and self.fault is None:
                left = left[super().write(left) :]
        except OSError as fault:
            self.fault = fault
        self.seek(len(left), os.SEEK_CUR)  # as if the bytes left were written
        return size

    def truncate(self, size: int | None = None) -> int:
        """Set the file's length; after a fault, do nothing."""
        try:
            return super().truncate(size) if self.fault is None else self.tell()
        except OSError as fault:
            self.fault = fault
            return self.tell()


class Hdf5Recorder:
    """Write samples to a draft file that gets its name when it is closed; an existing file is never overwritten.

    Parameters
    ----------
    path
        Of the new file.
    header
        Of the source.

    Raises
    ------
    FileExistsError
        The file exists.
    OSError
        No file can be written there.
    """

    def __init__(self, path: Path | str, header: Header) -> None:
        """Create the draft file next to ``path``, with empty datasets."""
        import h5py

        self.path, self._header = Path(path), header
        if self.path.exists():
            raise FileExistsError(17, os.strerror(17), str(path))  # 17: EEXIST
        name = f".{self.path.name[:50]}.{secrets.token_hex(4)}"
        self._draft, self._gaps, self._overruns = self.path.with_name(name), list[Gap](), 0
        self._disk = UnfailingFile(self._draft, "x+")  # default file permissions, unlike those of tempfile
        try:
            self._file = h5py.File(self._disk, "w")
            self._create_datasets()
        except BaseException:
            self._disk.close()
            self._draft.unlink()
            raise

    def _create_datasets(self) -> None:
        """Create the module's datasets, empty and growable, with units and checksums; ``time`` is the scale of each channel."""
        channels = self._header.channels
        for name, kind, unit in (("time", "f8", "s"), ("index", "i8", "1"), *((name, "f8", "V") for name in channels)):
            shape: dict[str, object] = {"shape": (0,), "maxshape": (None,), "chunks": (CHUNK_ROWS,)}
            self._file.create_dataset(name, dtype=f"<{kind}", fletcher32=True, **shape).attrs["units"] = unit
        shape = {"shape": (0, len(channels)), "maxshape": (None, len(channels)), "chunks": (CHUNK_ROWS, len(channels))}
        saturated = self._file.create_dataset("saturated", dtype="u1", fletcher32=True, **shape)
        saturated.attrs["channels"] = list(channels)
        self._file["time"].make_scale("time")
        for name in channels:
            self._file[name].dims[0].attach_scale(self._file["time"])

    def write_samples(self, samples: Samples) -> None:
        """Append samples.

        Raises
        ------
        OSError
            The disk is full, or another fault; nothing is left of the file.
        """
        self._check_disk()
        end = self._file["index"].shape[0] + len(samples)
        columns = dict(zip(samples.channels, samples.volts.T, strict=True))
        for name, values in ({"time": samples.times, "index": samples.index} | columns).items():
            self._file[name].resize(end, axis=0)
            self._file[name][end - len(samples) :] = values
        self._file["saturated"].resize(end, axis=0)
        self._file["saturated"][end - len(samples) :] = samples.saturated
        self._gaps.extend(samples.gaps)
        self._overruns += samples.overruns

    def close(self) -> None:
        """Write the source's properties, and give the file its name; without samples no file remains.

        Raises
        ------
        OSError
            The disk is full, the name was taken meanwhile, or another fault; nothing is left of the file.
        """
        if self._disk.closed:
            return
        try:
            samples = int(self._file["index"].shape[0])
            self._write_attributes()
            self._file.close()
            self._check_disk()
            if samples:
                os.fsync(self._disk.fileno())
                self.path.touch(exist_ok=False)  # fails if the name was taken: a move would overwrite that file
                self._draft.replace(self.path)
        finally:
            self.discard()

    def discard(self) -> None:
        """Delete the draft; a file that has its name already stays."""
        self._file.close()  # before the disk: HDF5 writes until its file is closed
        self._disk.close()
        self._draft.unlink(missing_ok=True)

    def _check_disk(self) -> None:
        """Raise the error of an earlier write if there was one."""
        if self._disk.fault is not None:
            raise self._disk.fault

    def _write_attributes(self) -> None:
        """Write the gaps and the properties of the source."""
        import h5py

        kinds = np.dtype([("first", "<i8"), ("count", "<i8"), ("reason", h5py.string_dtype())])
        gaps = [(gap.first, gap.count, gap.reason) for gap in self._gaps]
        self._file.create_dataset("gaps", data=np.array(gaps, kinds))
        source = self._header.source.items()
        known = {key: value if isinstance(value, str | int | float) else json.dumps(value) for key, value in source}
        properties = {"format": FILE_FORMAT, "version": FORMAT_VERSION, "rate": self._header.rate, "overruns": self._overruns}
        for key, value in (known | properties).items():
            self._file.attrs[key] = value

    def __enter__(self) -> Self:
        """Return the recorder."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Complete the file."""
        self.close()
