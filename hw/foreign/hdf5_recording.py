"""Write and replay recordings as HDF5: samples in volts with units, times, gaps, device and digests.

Datasets ``time`` (s), ``inner``, ``outer`` and ``force`` (V; ``time`` is their scale), ``index``, ``saturated`` (rows, channels)
and ``gaps`` (first, count, reason; count -1: unknown). Attributes: ``format``, ``version``, ``rate`` (Hz), ``overruns``
and the source's properties: ``started``, ``serial``, ``firmware``, ``scene_sha256``, ``calibration_sha256``.
"""

from __future__ import annotations

import json
import math
import os
import secrets
from collections.abc import Generator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from hw.common.clock import describe_rate_difference
from hw.common.errors import InvalidSource
from hw.common.limits import ReadLimits
from hw.common.samples import Gap, Samples
from hw.common.transport import Chunk, FileTransport, Header
from hw.foreign.hdf5_file import Hdf5File
from hw.foreign.hdf5_library import UnfailingFile, load_h5py
from hw.foreign.volts import build_volts_header, encode_note, pack_samples

FILE_FORMAT, FORMAT_VERSION = "probe-design samples", 1
CHUNK_ROWS = 1 << 15  # rows of a chunk
RATES_APART = 1e-4  # relative difference of stated rate and times: rounding of the times over a second causes less


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
    InvalidSource
        h5py is not installed.
    """

    def __init__(self, path: Path | str, header: Header) -> None:
        self.path, self._header = Path(path), header
        if self.path.exists():
            raise FileExistsError(17, os.strerror(17), str(path))
        name = f".{self.path.name[:50]}.{secrets.token_hex(4)}"
        self._draft, self._gaps, self._overruns = self.path.with_name(name), list[Gap](), 0
        self._disk = UnfailingFile(self._draft, "x+")  # default file permissions, unlike those of tempfile
        try:
            self._file = load_h5py().File(self._disk, "w")
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
        """Delete the draft; a file that was completed stays."""
        self._file.close()  # before the disk: HDF5 writes until its file is closed
        self._disk.close()
        self._draft.unlink(missing_ok=True)

    def _check_disk(self) -> None:
        if self._disk.fault is not None:
            raise self._disk.fault

    def _write_attributes(self) -> None:
        kinds = np.dtype([("first", "<i8"), ("count", "<i8"), ("reason", load_h5py().string_dtype())])
        self._file.create_dataset("gaps", data=np.array([(g.first, g.count, g.reason) for g in self._gaps], kinds))
        source = self._header.source.items()
        known = {key: value if isinstance(value, str | int | float) else json.dumps(value) for key, value in source}
        properties = {"format": FILE_FORMAT, "version": FORMAT_VERSION, "rate": self._header.rate, "overruns": self._overruns}
        for key, value in (known | properties).items():
            self._file.attrs[key] = value

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


class Hdf5Replay(FileTransport):
    """A transport that replays an HDF5 recording.

    Parameters
    ----------
    file
        A recording of this project (``is_recording``); ``close`` closes it.
    limits
        Of memory and time.

    Raises
    ------
    InvalidSource
        The recording has another version, is damaged, or claims more samples than the memory can hold.
    """

    def __init__(self, file: Hdf5File, limits: ReadLimits) -> None:
        self._file = file
        source = dict(file.attributes)
        if source.pop("version", None) != FORMAT_VERSION:
            raise InvalidSource(f"{file.path} is not a recording of version {FORMAT_VERSION}, as this program reads")
        channels = tuple(name for name in ("inner", "outer", "force") if name in file.datasets)
        columns = [file.datasets.get(name) for name in ("index", *channels)]
        self._rows = file.datasets["index"].shape[0] if "index" in file.datasets else 0
        is_whole = len(channels) > 1 and all(
            column is not None and column.whole and column.shape == (self._rows,) for column in columns
        )
        flags = file.datasets.get("saturated")
        rate, self._overruns = (source.pop(key, None) for key in ("rate", "overruns"))
        known = isinstance(rate, float | int) and 1e-6 < rate < 1e12 and isinstance(self._overruns, int)
        if not is_whole or not known or flags is None or flags.shape != (self._rows, len(channels)):
            raise InvalidSource(f"{file.path} is damaged: columns of different lengths, or no rate")
        limits.check_values(file.path.name, self._rows * (1 + len(channels)))
        times = file.datasets.get("time")
        self._has_times = times is not None and times.whole and times.shape == (self._rows,)
        self._first: tuple[float, float] | None = None  # index and time, s
        self._gaps = [Gap(*gap) for gap in file.gaps]
        source.pop("format")
        self.header = build_volts_header(float(rate), channels, **(source | {"replayed": str(file.path)}))
        self._chunks = self._iterate_chunks()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _iterate_chunks(self) -> Generator[Chunk, None, None]:
        overruns, gaps = self._overruns, list(self._gaps)
        channels = self.header.channels
        columns = [("index", None), *((name, None) for name in channels), *(("saturated", k) for k in range(len(channels)))]
        columns += [("time", None)] if self._has_times else []
        for begin in range(0, self._rows, CHUNK_ROWS):
            index, *values = self._file.read(columns, begin, min(begin + CHUNK_ROWS, self._rows))
            if self._has_times:
                self._compare_clock(index, values.pop())
            volts, saturated = (np.stack(part, axis=1) for part in (values[: len(channels)], values[len(channels) :]))
            gaps_before = tuple(gap for gap in gaps if gap.first <= index[-1])
            gaps = gaps[len(gaps_before) :]
            yield Chunk(pack_samples(index, volts, saturated), note=encode_note(gaps_before, overruns))
            overruns = 0

    def _compare_clock(self, index: NDArray[Any], times: NDArray[Any]) -> None:
        """Note in the header if the file's times contradict its rate; files without usable times are not compared."""
        self._first = self._first or (float(index[0]), float(times[0]))
        rows, seconds = float(index[-1]) - self._first[0], float(times[-1]) - self._first[1]
        if rows > 0 and 0 < seconds < math.inf and abs(rows / seconds / self.header.rate - 1) > RATES_APART:
            self.header.source["clock"] = describe_rate_difference(rows / seconds, self.header.rate)


def is_recording(file: Hdf5File) -> bool:
    """Whether an HDF5 file is a recording of this project."""
    return bool(file.attributes.get("format") == FILE_FORMAT)
