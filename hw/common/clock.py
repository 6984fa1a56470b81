"""Compare the sampling rate that a device states with the rate at which its samples arrive."""

from __future__ import annotations

from hw.common.samples import Samples
from hw.common.transport import Chunk

MAX_BUFFER_DELAY_S = 0.3  # s, delay between a sample and the chunk that brings it: buffers of device and host
RATE_TOLERANCE = 0.01  # relative error of the rate that is tolerated
MIN_ELAPSED_S = 2.0  # s of stream before the rates are compared: a shorter one is dominated by the delay


class Clock:
    """Compare sample indices with arrival times, from the first chunk of a stream to the last.

    Parameters
    ----------
    rate
        As the device states it, Hz.
    """

    def __init__(self, rate: float) -> None:
        """Start before the first chunk."""
        self._rate = rate
        self._first: tuple[float, int] | None = None  # time of the stream's first chunk, s, and index of its last sample
        self._stream = 0

    def describe_difference(self, chunk: Chunk, block: Samples) -> str | None:
        """Describe the difference between the measured and the stated rate; return None if they agree, or it is too early.

        Parameters
        ----------
        chunk
            For the time of its arrival.
        block
            The chunk's samples, at least one.
        """
        if chunk.time is None:
            return None
        now = (chunk.time, int(block.index[-1]))
        if self._first is None or chunk.stream != self._stream:  # the device was started again: its index begins at 0
            self._first, self._stream = now, chunk.stream
        elapsed = now[0] - self._first[0]
        if elapsed < MIN_ELAPSED_S:
            return None
        rate = (now[1] - self._first[1]) / elapsed
        if abs(rate / self._rate - 1) < RATE_TOLERANCE + MAX_BUFFER_DELAY_S / elapsed:
            return None
        return describe_rate_difference(rate, self._rate)


def describe_rate_difference(timed: float, stated: float) -> str:
    """Describe a difference between the rate of the time stamps and the stated rate, both in Hz."""
    return f"the time stamps give {timed:.4g} samples a second, not the stated {stated:.6g}: frequencies have the same error"
