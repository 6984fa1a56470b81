"""Encode and decode samples as plain volts, for files of other programs and adapters of other hardware.

A chunk holds rows: i64 index, f64 volts of each channel, u8 saturation of each, all little-endian. Missing samples are left out:
the index jumps, and the neighbouring rows are unchanged.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hw.common.errors import InvalidSource
from hw.common.samples import CHANNEL_NAMES, Bools, Floats, Gap, Ints, Samples
from hw.common.transport import Chunk, FileTransport, Header, make_timestamp

MAX_VOLTS = 1e6  # no instrument gives more: beyond it a file is damaged, and squares of it overflow
GAP_REASON = "samples are missing in what was recorded"
CHUNK_ROWS = 1 << 15  # rows of a chunk


def build_row_type(channels: int) -> np.dtype[np.void]:
    """Return the structured type of a row."""
    return np.dtype([("index", "<i8"), ("volts", "<f8", (channels,)), ("saturated", "u1", (channels,))])


def pack_samples(index: ArrayLike, volts: ArrayLike, saturated: ArrayLike = False) -> bytes:
    """Encode samples as the bytes of a chunk.

    Parameters
    ----------
    index
        (n,) index of each row since the start, increasing; it jumps where samples were lost.
    volts
        (n, channels), finite.
    saturated
        (n, channels), or one value for all.
    """
    values = np.asarray(volts, dtype=float)
    data = np.zeros(len(values), build_row_type(values.shape[1]))
    data["index"], data["volts"], data["saturated"] = index, values, saturated
    return data.tobytes()


def build_volts_header(rate: float, channels: tuple[str, ...] = CHANNEL_NAMES[:2], **source: object) -> Header:
    """Build the header of a source of volts.

    Parameters
    ----------
    rate
        Samples per second and channel, Hz.
    channels
        Names of the columns: inner, outer and perhaps force.
    source
        Properties of the source, such as ``transport`` and ``serial``.
    """
    return Header("volts", rate, channels, (1.0,) * len(channels), 0, 0, {"started": make_timestamp()} | source)


class VoltsTransport(FileTransport):
    """A transport of a file's samples, which are in memory.

    Parameters
    ----------
    header
        Of a source of volts.
    index, volts, saturated
        As of ``pack_samples``.
    """

    def __init__(self, header: Header, index: Ints, volts: Floats, saturated: Bools) -> None:
        self.header = header
        starts = range(0, len(index), CHUNK_ROWS)
        parts = (slice(first, first + CHUNK_ROWS) for first in starts)
        self._chunks = (Chunk(pack_samples(index[rows], volts[rows], saturated[rows])) for rows in parts)


class VoltsDecoder:
    """A decoder that turns chunks of volts into samples; ``header`` is that of their source."""

    def __init__(self, header: Header) -> None:
        self.header = header
        self._rows = build_row_type(len(header.channels))
        self._next: int | None = None

    def feed(self, data: bytes, stream: int | None = None, note: str = "") -> Samples:
        """Return the samples of a chunk; a note is the reason of its gaps.

        Raises
        ------
        InvalidSource
            Incomplete rows, an index that does not increase, or values that are not finite.
        """
        if len(data) % self._rows.itemsize:
            raise InvalidSource(f"{len(data)} bytes of volts: allowed: whole rows of {self._rows.itemsize} bytes")
        rows = np.frombuffer(data, self._rows)
        index, volts = rows["index"].astype(np.int64), rows["volts"].astype(float)
        first = 0 if self._next is None else self._next  # the index expected next
        steps = np.diff(index, prepend=first - 1)
        if not (np.abs(volts) <= MAX_VOLTS).all() or (steps < 1).any():
            raise InvalidSource(f"volts: values that are no numbers or above {MAX_VOLTS:g} V, or an index that does not increase")
        gaps = self._find_gaps(index, steps, note or GAP_REASON)
        self._next = int(index[-1]) + 1 if len(index) else self._next
        header = self.header
        return Samples(
            header.rate, header.channels, index, volts, rows["saturated"].astype(bool),
            gaps=gaps, overruns=0, source=header.source,
        )  # fmt: skip

    def _find_gaps(self, index: Ints, steps: Ints, reason: str) -> tuple[Gap, ...]:
        """Return the gaps where an index jumps; ``steps`` holds the difference of each index from the one before."""
        jumps = np.flatnonzero(steps > 1)
        if self._next is None:
            jumps = jumps[jumps > 0]  # rows before the first one read are no gap
        return tuple(Gap(int(index[k] - steps[k] + 1), int(steps[k] - 1), reason) for k in jumps)
