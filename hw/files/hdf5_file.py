"""Read HDF5 files of unknown origin within limits of memory and time.

A file is a recording of this project, or a table of another program: a 1-D dataset is a column, a matrix gives one for each of
its columns. Links and creation properties are inspected before any data are read: a file with data elsewhere (external links,
external storage, virtual datasets) is refused, and so is one that claims more values than the memory can hold.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from hw.common.clock import describe_rate_difference
from hw.common.errors import InvalidSource
from hw.common.limits import ReadLimits
from hw.common.samples import CHANNEL_NAMES, Floats, Gap
from hw.files.columns import build_refusal
from hw.files.hdf5_recorder import FILE_FORMAT, FORMAT_VERSION
from hw.files.table import ColumnTable
from hw.files.volts import VoltsTransport, build_volts_header

if TYPE_CHECKING:
    import h5py

RATE_ATTRIBUTES = ("rate", "sample_rate", "sampling_rate", "SampleRate", "fs")
UNIT_ATTRIBUTES = ("units", "unit", "Units", "Unit")
MAX_MATRIX_COLUMNS = 16  # a wider matrix is a picture, not channels
MAX_DATASETS = 1000  # a file with more datasets is not a recording
RATE_TOLERANCE = 1e-4  # relative difference of stated rate and times: rounding of the times over a second causes less
_STORED_ELSEWHERE = "is not stored in this file: allowed: datasets within it (h5copy or h5repack writes such a file)"


@dataclass(frozen=True)
class Dataset:
    """The description of a dataset of numbers; its data are not read yet.

    Attributes
    ----------
    path
        Within the file, ``group/name``.
    shape
        Of one or two dimensions.
    unit
        As text; empty where none is stated.
    is_complete
        Whether all its values are stored, uncompressed: HDF5 returns zeros for values that were never written.
    is_written
        Whether any value is stored.
    """

    path: str
    shape: tuple[int, ...]
    unit: str
    is_complete: bool
    is_written: bool


class Hdf5File:
    """An open HDF5 file; a context manager that closes it.

    Parameters
    ----------
    path
        Of the file.
    limits
        Memory and time for all that is read.

    Attributes
    ----------
    attributes
        Texts and numbers of the file's root.
    datasets
        Descriptions by path.
    gaps
        What was lost, if the file is a recording of this project.

    Raises
    ------
    InvalidSource
        The file is not HDF5, is damaged, refers to data outside itself, or exceeds a limit.
    """

    def __init__(self, path: Path, limits: ReadLimits) -> None:
        import h5py

        self.path, self._limits, self._end = path, limits, time.monotonic() + limits.seconds
        try:
            self._file = h5py.File(path, "r")
        except (OSError, RuntimeError, ValueError):
            raise InvalidSource(f"{path} is no HDF5 file that can be read: is it whole, is it HDF5?") from None
        self.datasets: dict[str, Dataset] = {}
        try:
            with self._convert_faults():
                # a visit ends at the first step that returns a reason
                reason = self._file.visititems_links(self._find_data_elsewhere) or self._file.visititems(self._add_dataset)
                if reason:
                    raise InvalidSource(f"{path} is refused: {reason}")
                entries = self._file.attrs.items()
                self.attributes: dict[str, Any] = {
                    key: value for key, entry in entries if (value := _convert_attribute(entry)) is not None
                }
                self.gaps = _read_gaps(self._file)
        except BaseException:
            self.close()
            raise

    @property
    def is_recording(self) -> bool:
        """Whether the file is a recording of this project."""
        return bool(self.attributes.get("format") == FILE_FORMAT)

    def read(self, columns: Sequence[tuple[str, int | None]]) -> list[NDArray[Any]]:
        """Return columns, each given by its dataset's path and a matrix column or None; floats are doubles.

        Raises
        ------
        InvalidSource
            They cannot be read within the limits.
        """
        arrays = []
        for path, column in columns:
            with self._convert_faults():
                arrays.append(_read_column(self._file[path], path, column))
        return arrays

    def build_table(self) -> ColumnTable:
        """Return the file as a table, whose columns are named ``group/name``, or ``group/name[1]`` in a matrix.

        The file must stay open until the table is read.

        Raises
        ------
        InvalidSource
            The file holds no columns of numbers.
        """
        columns: list[tuple[str, Dataset, int | None]] = []
        for dataset in self.datasets.values():
            if len(dataset.shape) == 1:
                columns.append((dataset.path, dataset, None))
            elif dataset.shape[1] <= MAX_MATRIX_COLUMNS:
                columns.extend((f"{dataset.path}[{k + 1}]", dataset, k) for k in range(dataset.shape[1]))
        if not columns:
            raise build_refusal(self.path.name, "no columns of numbers", "an HDF5 file with datasets of one or two dimensions")

        def read(numbers: list[int]) -> Floats:
            wanted = [columns[number] for number in numbers]
            self._check_columns(wanted)
            return np.stack(self.read([(dataset.path, k) for _, dataset, k in wanted]), axis=1).astype(float, copy=False)

        names, units = tuple(name for name, _, _ in columns), tuple(dataset.unit for _, dataset, _ in columns)
        return ColumnTable(self.path.name, names, units, read, self._find_rate(), source={"transport": "hdf5"})

    def read_recording(self) -> VoltsTransport:
        """Read a recording of this project.

        Raises
        ------
        InvalidSource
            The recording has another version, is damaged, or claims more samples than the memory can hold.
        """
        source = dict(self.attributes)
        if source.pop("version", None) != FORMAT_VERSION:
            raise InvalidSource(f"{self.path} is not a recording of version {FORMAT_VERSION}, as this program reads")
        channels = tuple(name for name in CHANNEL_NAMES if name in self.datasets)
        rows = self.datasets["index"].shape[0] if "index" in self.datasets else 0
        has_columns = all(self._is_complete(name, (rows,)) for name in ("index", *channels))
        has_flags = "saturated" in self.datasets and self.datasets["saturated"].shape == (rows, len(channels))
        rate, overruns, _ = (source.pop(key, None) for key in ("rate", "overruns", "format"))
        has_rate = isinstance(rate, float | int) and 1e-6 < rate < 1e12 and isinstance(overruns, int)
        if len(channels) < 2 or not (has_columns and has_flags and has_rate):
            raise InvalidSource(f"{self.path} is damaged: columns of different lengths, or no rate")
        self._limits.check_values(self.path.name, rows * (1 + len(channels)))
        flags = [("saturated", k) for k in range(len(channels))]
        index, *values = self.read([("index", None), *((name, None) for name in channels), *flags])
        volts, saturated = (np.stack(part, axis=1) for part in (values[: len(channels)], values[len(channels) :]))
        header = build_volts_header(float(rate), channels, **(source | {"replayed": str(self.path)}))
        if self._is_complete("time", (rows,)) and (difference := self._describe_clock(index, header.rate)):
            header.source["clock"] = difference
        return VoltsTransport(header, index, volts, saturated, gaps=self.gaps, overruns=overruns)

    def _is_complete(self, name: str, shape: tuple[int, ...]) -> bool:
        """Whether a dataset has this shape and all its values."""
        dataset = self.datasets.get(name)
        return dataset is not None and dataset.is_complete and dataset.shape == shape

    def _check_columns(self, columns: Sequence[tuple[str, Dataset, int | None]]) -> None:
        """Refuse columns that do not fit together, were never written, or are too large: a few bytes can claim any number."""
        lengths = {name: dataset.shape[0] for name, dataset, _ in columns}
        if len(set(lengths.values())) > 1:
            raise build_refusal(self.path.name, f"columns of {lengths}", "the same number of samples in each")
        for name, dataset, _ in columns:
            if not dataset.is_written:
                raise build_refusal(self.path.name, f"{name}, which was never written", "columns that hold samples")
        self._limits.check_values(self.path.name, sum(lengths.values()))

    def _find_rate(self) -> float | None:
        """Return the rate in Hz that a table states, or None."""
        values = [self.attributes[key] for key in RATE_ATTRIBUTES if key in self.attributes]
        return next((float(value) for value in values if not isinstance(value, str) and value > 0), None)

    def _describe_clock(self, index: NDArray[Any], rate: float) -> str:
        """Describe by how much a recording's times contradict its rate; empty if they do not, or are unusable."""
        (times,) = self.read([("time", None)])
        rows, seconds = float(index[-1] - index[0]), float(times[-1] - times[0])
        if rows > 0 and 0 < seconds < math.inf and abs(rows / seconds / rate - 1) > RATE_TOLERANCE:
            return describe_rate_difference(rows / seconds, rate)
        return ""

    def _find_data_elsewhere(self, name: str, link: object) -> str | None:
        """Return a reason if an entry refers to data outside the file. Later steps follow only hard and soft links."""
        import h5py

        if isinstance(link, h5py.ExternalLink):
            return f"{name!r} {_STORED_ELSEWHERE}"
        node = self._file[name] if isinstance(link, h5py.HardLink) else None
        if isinstance(node, h5py.Dataset) and (node.is_virtual or node.external):
            return f"the data of {name!r} {_STORED_ELSEWHERE}"
        return None

    def _add_dataset(self, path: str, node: h5py.Group | h5py.Dataset) -> str | None:
        """Add a description if an entry is a dataset of numbers; return a reason if it cannot be read within the limits."""
        if not getattr(node, "shape", None) or len(node.shape) > 2 or node.dtype.kind not in "iuf":
            return None
        chunk_bytes = math.prod(node.chunks or (0,)) * node.dtype.itemsize
        if 2 * chunk_bytes > self._limits.memory:  # HDF5 holds a whole chunk, compressed and uncompressed, for any of its values
            return f"{path!r} is stored in chunks of {chunk_bytes / 1e9:.3g} GB: --memory raises the limit"
        units = [_decode_text(node.attrs[key]) for key in UNIT_ATTRIBUTES if key in node.attrs]
        stored_bytes = node.id.get_storage_size()
        is_complete = stored_bytes >= math.prod(node.shape) * node.dtype.itemsize
        self.datasets[path] = Dataset(path, node.shape, units[0] if units else "", is_complete, stored_bytes > 0)
        if len(self.datasets) > MAX_DATASETS:
            return f"more than {MAX_DATASETS} datasets of numbers: allowed: the recording's columns alone"
        return None

    @contextmanager
    def _convert_faults(self) -> Iterator[None]:
        """Turn whatever the HDF5 library raises on a damaged file into ``InvalidSource``, and check the time."""
        try:
            yield
        except InvalidSource:
            raise
        except MemoryError:
            limit = f"{self._limits.memory / 1e9:g} GB"
            raise InvalidSource(
                f"{self.path} needs more than the {limit} allowed to read it: --memory raises the limit"
            ) from None
        except Exception:
            raise InvalidSource(f"{self.path} is damaged: parts of it are missing or cannot be read") from None
        if time.monotonic() >= self._end:
            limit = f"{self._limits.seconds:g} s"
            raise InvalidSource(f"{self.path} takes longer than {limit} to read: --time raises the limit")

    def close(self) -> None:
        """Close the file."""
        with suppress(Exception):  # of a damaged file, which is refused already
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def _read_gaps(file: h5py.File) -> tuple[Gap, ...]:
    """Return the gaps of a recording of this project; empty for other files."""
    if "gaps" not in file or getattr(file["gaps"].dtype, "names", None) != ("first", "count", "reason"):
        return ()
    return tuple(Gap(int(row["first"]), int(row["count"]), _decode_text(row["reason"])) for row in file["gaps"][:])


def _read_column(dataset: h5py.Dataset, path: str, column: int | None) -> NDArray[Any]:
    """Return a dataset, or one column of a matrix; floats, and integers that may exceed 64 bits with a sign, as doubles."""
    from h5py import h5z

    properties = dataset.id.get_create_plist()
    for number, _, _, name in (properties.get_filter(k) for k in range(properties.get_nfilters())):
        if not h5z.filter_avail(number):
            filter_name = f"{number} ({_decode_text(name)})" if name else str(number)
            allowed = "gzip, szip, lzf, shuffle, fletcher32 (h5repack -f GZIP=4 writes such a file)"
            refused = f"{dataset.file.filename} is refused: {path!r} is packed by filter {filter_name}"
            raise InvalidSource(f"{refused}, which is not installed: allowed: {allowed}")
    values: NDArray[Any] = dataset[:] if column is None else dataset[:, column]
    if values.dtype.kind != "f" and values.dtype != np.uint64:
        return values
    with np.errstate(over="ignore"):  # long doubles beyond the range of doubles become infinite; they are refused later
        return values.astype(float, copy=False)


def _convert_attribute(value: object) -> object:
    """Convert an attribute to a text, a number, or the first number of an array; None for anything else."""
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, bytes | str):
        return _decode_text(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, np.ndarray) and value.size and value.dtype.kind in "iuf":
        return _convert_attribute(value.reshape(-1)[0])
    return value if isinstance(value, int | float) else None


def _decode_text(value: object) -> str:
    """Decode a text, with invalid UTF-8 replaced."""
    decoded = value if isinstance(value, bytes) else str(value).encode("utf-8", "replace")
    return decoded.decode("utf-8", "replace")
