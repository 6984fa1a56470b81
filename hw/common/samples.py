"""Hold the samples of a reader: volts by index. Every loss is marked, and none is filled in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hw.common.errors import Overrun, TransferError

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
FILM_NAMES = ("inner", "outer")
FORCE_CHANNEL = "force"
CHANNEL_NAMES = (*FILM_NAMES, FORCE_CHANNEL)
NOTE_KEYS = ("cut", "damaged", "clock", "unrecorded")  # keys of a source's remarks, texts


@dataclass(frozen=True)
class Gap:
    """Consecutive samples that were lost.

    Attributes
    ----------
    first
        Index of the first lost sample.
    count
        Number of lost samples; -1 if unknown (the device restarted). An unknown gap takes up one index.
    reason
        What happened.
    """

    first: int
    count: int
    reason: str


@dataclass(frozen=True)
class Samples:
    """Samples of all channels over a part of the stream.

    Attributes
    ----------
    rate
        Samples per second and channel, Hz.
    channels
        Names of the columns: ("inner", "outer") or with "force".
    index
        (n,) index of each row since the start of the stream, increasing; it jumps only at gaps.
    volts
        (n, channels) at the input of the converter.
    saturated
        (n, channels) whether a value is at the end of the converter's range, or its amplifier was saturated.
    gaps
        What was lost, in order; a gap belongs to the part whose samples follow it.
    overruns
        Number of overflows of its own buffer that the device reported.
    source
        Origin of the samples: serial, firmware, transport, started (ISO 8601, UTC), scale (V per count).
    """

    rate: float
    channels: tuple[str, ...]
    index: Ints
    volts: Floats
    saturated: Bools
    gaps: tuple[Gap, ...]
    overruns: int
    source: dict[str, object]

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.index)

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the source besides gaps, one line each: a recording that is cut or damaged, a clock that differs."""
        return tuple(str(self.source[key]) for key in NOTE_KEYS if key in self.source)

    @property
    def times(self) -> Floats:
        """Times of the rows since the start of the stream, s, shape (n,)."""
        return self.index / self.rate

    def select_before(self, index: int) -> Samples:
        """Return the rows with an index below ``index``, and the gaps that begin below it."""
        end = int(np.searchsorted(self.index, index))  # number of rows with a smaller index
        gaps = tuple(gap for gap in self.gaps if gap.first < index)
        return replace(self, index=self.index[:end], volts=self.volts[:end], saturated=self.saturated[:end], gaps=gaps)

    def select_from(self, index: int) -> Samples:
        """Return the rows from ``index`` on, and the gaps that begin there; overruns count in the part before."""
        begin = int(np.searchsorted(self.index, index))
        gaps = tuple(gap for gap in self.gaps if gap.first >= index)
        rows = self.index[begin:], self.volts[begin:], self.saturated[begin:]
        return replace(self, index=rows[0], volts=rows[1], saturated=rows[2], gaps=gaps, overruns=0)

    def select_channels(self, names: Sequence[str]) -> Samples:
        """Return the samples of the named channels, in this order; all of them must exist."""
        columns = [self.channels.index(name) for name in names]
        return replace(self, channels=tuple(names), volts=self.volts[:, columns], saturated=self.saturated[:, columns])

    def require_complete(self) -> Samples:
        """Return the samples unchanged if none was lost, as a calibration requires.

        Raises
        ------
        Overrun
            The device lost samples.
        TransferError
            Samples were lost on the way, or the source has a remark.
        """
        if self.overruns:
            raise Overrun(f"the device's buffer ran over {self.overruns} times: ask for a lower rate, or free the computer")
        if self.notes:
            raise TransferError(f"{self.notes[0]}: read again")
        if self.gaps:
            first = self.gaps[0]
            raise TransferError(f"samples from index {first.first} on were lost ({first.reason}): read again")
        return self


def join_samples(parts: Sequence[Samples]) -> Samples:
    """Join consecutive parts of one stream; there must be at least one."""
    return replace(
        parts[-1],
        index=np.concatenate([part.index for part in parts]),
        volts=np.concatenate([part.volts for part in parts]),
        saturated=np.concatenate([part.saturated for part in parts]),
        gaps=tuple(gap for part in parts for gap in part.gaps),
        overruns=sum(part.overruns for part in parts),
    )
