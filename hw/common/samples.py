"""Samples as they leave a reader: volts by index, with every loss marked and none filled in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hw.common.errors import Overrun, TransferError

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
NOTES = ("cut", "damaged", "clock", "unrecorded")  # of a source, in words


@dataclass(frozen=True)
class Gap:
    """Samples that were lost, never filled in.

    Attributes:
        first: index of the first lost sample.
        count: how many; -1 if unknown (the device restarted). An unknown gap takes up one index.
        reason: what happened.
    """

    first: int
    count: int
    reason: str


@dataclass(frozen=True)
class Samples:
    """A stretch of the stream.

    Attributes:
        rate: samples per second and channel, Hz.
        channels: names of the columns: ("inner", "outer") or with "force".
        index: (n,) index of each row since the start of the stream, increasing; it jumps at gaps and nowhere else.
        volts: (n, channels) at the input of the converter.
        saturated: (n, channels) where a value is at the end of the converter's range, or its amplifier was.
        gaps: what was lost, in order; a gap belongs to the stretch whose samples follow it.
        overruns: how often the device said that its own buffer ran over.
        source: where the samples come from: serial, firmware, transport, started (ISO 8601, UTC), scale (V per count).
    """

    rate: float
    channels: tuple[str, ...]
    index: Ints
    volts: Floats
    saturated: Bools
    gaps: tuple[Gap, ...]
    overruns: int
    source: dict[str, Any]

    def __len__(self) -> int:
        return len(self.index)

    @property
    def notes(self) -> tuple[str, ...]:
        """Return what is to be said of the source beside the gaps: a recording that is cut or damaged, a clock that differs."""
        return tuple(str(self.source[key]) for key in NOTES if key in self.source)

    @property
    def times(self) -> Floats:
        """Return (n,) times since the start of the stream, s."""
        return self.index / self.rate

    def before(self, index: int) -> Samples:
        """Return the rows with a lower index, and the gaps that begin before it."""
        end = int(np.searchsorted(self.index, index))
        gaps = tuple(gap for gap in self.gaps if gap.first < index)
        return replace(self, index=self.index[:end], volts=self.volts[:end], saturated=self.saturated[:end], gaps=gaps)

    def after(self, index: int) -> Samples:
        """Return the rows from an index on, and the gaps that begin there or later; overruns count before it."""
        begin = int(np.searchsorted(self.index, index))
        gaps = tuple(gap for gap in self.gaps if gap.first >= index)
        rows = self.index[begin:], self.volts[begin:], self.saturated[begin:]
        return replace(self, index=rows[0], volts=rows[1], saturated=rows[2], gaps=gaps, overruns=0)

    def of(self, names: Sequence[str]) -> Samples:
        """Return these channels alone, in this order; all must be there."""
        columns = [self.channels.index(name) for name in names]
        return replace(self, channels=tuple(names), volts=self.volts[:, columns], saturated=self.saturated[:, columns])

    def whole(self) -> Samples:
        """Return the samples if none was lost: what a calibration needs.

        Raises:
            Overrun: the device lost samples itself.
            TransferError: samples were lost on the way.
        """
        if self.overruns:
            raise Overrun(f"the device's buffer ran over {self.overruns} times: ask for a lower rate, or free the computer")
        if self.notes:
            raise TransferError(f"{self.notes[0]}: read again")
        if self.gaps:
            first = self.gaps[0]
            raise TransferError(f"samples from index {first.first} on were lost ({first.reason}): read again")
        return self


def joined(parts: Sequence[Samples]) -> Samples:
    """Return consecutive stretches of one stream as one; there must be at least one."""
    return replace(
        parts[-1],
        index=np.concatenate([part.index for part in parts]),
        volts=np.concatenate([part.volts for part in parts]),
        saturated=np.concatenate([part.saturated for part in parts]),
        gaps=tuple(gap for part in parts for gap in part.gaps),
        overruns=sum(part.overruns for part in parts),
    )
