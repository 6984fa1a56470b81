"""Write recordings as HDF5: samples in volts with units, times, gaps, device and digests.

Datasets ``time`` (s), ``inner``, ``outer`` and ``force`` (V; ``time`` is their scale), ``index``, ``saturated`` (rows, channels)
and ``gaps`` (first, count, reason; count -1: unknown). Attributes: ``format``, ``version``, ``rate`` (Hz), ``overruns``
and the source's properties: ``started``, ``serial``, ``firmware``, ``scene_sha256``, ``calibration_sha256``.
"""

from __future__ import annotations

import json
import os
import secrets
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from hw.common.samples import Samples, join_samples
from hw.common.transport import Header

FILE_FORMAT, FORMAT_VERSION = "probe-design samples", 1
CHUNK_ROWS = 1 << 15  # rows of a chunk, which has a checksum


class Hdf5Recorder:
    """Collect samples, and write them to a new file when it is closed; an existing file is never overwritten.

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
        self.path, self._header = Path(path), header
        if self.path.exists():
            raise FileExistsError(17, os.strerror(17), str(path))
        self._draft_path = self.path.with_name(f".{self.path.name[:50]}.{secrets.token_hex(4)}")
        self._draft = self._draft_path.open("xb")  # default file permissions, unlike those of tempfile
        self._parts: list[Samples] = []

    def write_samples(self, samples: Samples) -> None:
        """Add samples."""
        self._parts.append(samples)

    def close(self) -> None:
        """Write the samples and the source's properties; without samples no file remains.

        Raises
        ------
        OSError
            The disk is full, the name was taken meanwhile, or another fault; nothing is left of the file.
        """
        if self._draft.closed:
            return
        try:
            if any(map(len, self._parts)):
                self._draft.write(build_file(join_samples(self._parts), self._header))
                self._draft.flush()
                os.fsync(self._draft.fileno())
                self.path.touch(exist_ok=False)  # fails if the name was taken: a move would overwrite that file
                self._draft_path.replace(self.path)
        finally:
            self.discard()

    def discard(self) -> None:
        """Delete the draft; a file that was completed stays."""
        self._draft.close()
        self._draft_path.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def build_file(samples: Samples, header: Header) -> memoryview:
    """Return the bytes of an HDF5 file; in memory, since HDF5 crashes the program where a disk is full."""
    import h5py

    content = BytesIO()
    with h5py.File(content, "w") as file:
        columns = {"time": (samples.times, "s"), "index": (samples.index, "1")}
        columns |= {name: (volts, "V") for name, volts in zip(samples.channels, samples.volts.T, strict=True)}
        for name, (values, unit) in columns.items():
            file.create_dataset(name, data=values, chunks=(CHUNK_ROWS,), maxshape=(None,), fletcher32=True).attrs["units"] = unit
        shape = {"chunks": (CHUNK_ROWS, len(samples.channels)), "maxshape": (None, len(samples.channels))}
        saturated = file.create_dataset("saturated", data=samples.saturated.astype("u1"), fletcher32=True, **shape)
        saturated.attrs["channels"] = list(samples.channels)
        file["time"].make_scale("time")
        for name in samples.channels:
            file[name].dims[0].attach_scale(file["time"])
        kinds = np.dtype([("first", "<i8"), ("count", "<i8"), ("reason", h5py.string_dtype())])
        file.create_dataset("gaps", data=np.array([(gap.first, gap.count, gap.reason) for gap in samples.gaps], kinds))
        for key, value in header.source.items():
            file.attrs[key] = value if isinstance(value, str | int | float) else json.dumps(value)
        file.attrs.update({"format": FILE_FORMAT, "version": FORMAT_VERSION, "rate": header.rate, "overruns": samples.overruns})
    return content.getbuffer()
