"""Encode and decode samples as plain volts, for files of other programs and adapters of other hardware.

A chunk holds rows: i64 index, f64 volts of each channel, u8 saturation of each, all little-endian. Missing samples are left out:
the index jumps, and the neighbouring rows are unchanged.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hw.common.errors import InvalidSource
from hw.common.samples import Floats, Gap, Ints, Samples
from hw.common.transport import Header, now

CHANNELS = ("inner", "outer", "force")
MAX_VOLTS = 1e6  # no instrument gives more: beyond it a file is damaged, and squares of it overflow
MISSING = "samples are missing in what was recorded"


def rows(channels: int) -> np.dtype[np.void]:
    """Return the structured type of a row."""
    return np.dtype([("index", "<i8"), ("volts", "<f8", (channels,)), ("saturated", "u1", (channels,))])


def packed(index: ArrayLike, volts: ArrayLike, saturated: ArrayLike = False) -> bytes:
    """Encode samples as the bytes of a chunk.

    Args:
        index: (n,) index of each row since the start, increasing; it jumps where samples were lost.
        volts: (n, channels), finite.
        saturated: (n, channels), or one value for all.
    """
    values = np.asarray(volts, dtype=float)
    data = np.zeros(len(values), rows(values.shape[1]))
    data["index"], data["volts"], data["saturated"] = index, values, saturated
    return data.tobytes()


def unknown_gap(first: int, reason: str) -> str:
    """Encode the note of a chunk that follows a gap of unknown length; the gap takes up index ``first``."""
    return noted((Gap(first, -1, reason),))


def noted(gaps: tuple[Gap, ...], overruns: int = 0) -> str:
    """Encode a chunk's note that lists its gaps; without a note, gaps follow from the index."""
    return json.dumps({"gaps": [[gap.first, gap.count, gap.reason] for gap in gaps], "overruns": overruns})


def volts_header(rate: float, channels: tuple[str, ...] = CHANNELS[:2], **source: Any) -> Header:
    """Build the header of a source of volts.

    Args:
        rate: samples per second and channel, Hz.
        channels: names of the columns: inner, outer and perhaps force.
        source: properties of the source, such as ``transport`` and ``serial``.
    """
    return Header("volts", rate, channels, (1.0,) * len(channels), 0, 0, {"started": now()} | source)


class VoltsDecoder:
    """A decoder that turns chunks of volts into samples."""

    def __init__(self, header: Header) -> None:
        self.header = header
        self._rows = rows(len(header.channels))
        self._next: int | None = None

    def feed(self, data: bytes, stream: int | None = None, note: str = "") -> Samples:
        """Return the samples of a chunk.

        Raises:
            InvalidSource: incomplete rows, an index that does not increase, or values that are not finite.
        """
        if len(data) % self._rows.itemsize:
            raise InvalidSource(f"{len(data)} bytes of volts: allowed: whole rows of {self._rows.itemsize} bytes")
        found = np.frombuffer(data, self._rows)
        index, volts = found["index"].astype(np.int64), found["volts"].astype(float)
        first = 0 if self._next is None else self._next
        steps = np.diff(index, prepend=first - 1)
        if not (np.abs(volts) <= MAX_VOLTS).all() or (steps < 1).any():
            raise InvalidSource(f"volts: values that are no numbers or above {MAX_VOLTS:g} V, or an index that does not increase")
        gaps, overruns = _told(note) if note else (self._jumps(index, steps), 0)
        self._next = int(index[-1]) + 1 if len(index) else self._next
        header = self.header
        return Samples(
            header.rate, header.channels, index, volts, found["saturated"].astype(bool),
            gaps=gaps, overruns=overruns, source=header.source,
        )  # fmt: skip

    def _jumps(self, index: Ints, steps: Ints) -> tuple[Gap, ...]:
        at = np.flatnonzero(steps > 1)
        if self._next is None:
            at = at[at > 0]  # rows before the first one read are no gap
        return tuple(Gap(int(index[k] - steps[k] + 1), int(steps[k] - 1), MISSING) for k in at)


def finite(volts: Floats) -> Floats:
    """Replace NaN and infinities by finite numbers, in rows that count as lost or saturated."""
    return np.asarray(np.nan_to_num(volts, nan=0.0))


def _told(note: str) -> tuple[tuple[Gap, ...], int]:
    try:
        told = json.loads(note)
        return tuple(Gap(int(first), int(count), str(why)) for first, count, why in told["gaps"]), int(told["overruns"])
    except (ValueError, TypeError, KeyError) as fault:
        raise InvalidSource("a note of volts that lists no gaps: another program wrote it") from fault
