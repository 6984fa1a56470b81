"""Model the firmware of ``docs/reference/protocol.md``, for the virtual probe."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hw.common.samples import Floats
from hw.wire.frames import MAX_CODE, MIN_CODE, Codes, FrameLayout, encode_frame
from hw.wire.protocol import GET_INFO, GET_STATUS, RATE_FORMAT, SET_RATE, START, STOP, Info, Status

MAX_FRAME_DURATION_S = 0.05  # s, of docs/reference/protocol.md


class Halted(Exception):  # noqa: N818 - a state of the endpoint
    """The endpoint is halted, or the request refused."""


class Firmware:
    """The state and the stream of one simulated device.

    Attributes
    ----------
    layout
        Of its frames.
    rate
        Hz.
    index
        Of the next conversion.
    sent
        Sequence number of the next frame.
    """

    def __init__(self, signals: Callable[[Floats], Floats], rate: float, scale: tuple[float, ...], packet: int) -> None:
        """Build a stopped device; for the parameters see ``hw.simulation.virtual.make_virtual_probe``."""
        self.layout, self.rate = FrameLayout(packet, len(scale)), rate
        self._signals, self._scale = signals, np.array(scale, np.float32).astype(float)  # as GET_INFO reports it
        self._max_rate = rate
        self.stream, self.index, self.sent, self.overruns = 0, 0, 0, 0
        self._ready = b""

    def control(self, request: int, value: int, data: bytes) -> bytes:
        """Return the response to a vendor request with its value and data. Raises ``Halted`` when it is refused."""
        if request == GET_INFO:
            return Info(self.layout.channels, self.rate, self._max_rate, tuple(self._scale), "virtual 1").encode()
        if request == GET_STATUS:
            return Status(self.stream, self.overruns, self.sent, self.index).encode()
        if request == SET_RATE and not self.stream and len(data) == RATE_FORMAT.size:
            self.rate = min(self._max_rate, max(1.0, RATE_FORMAT.unpack(data)[0] / 1e3))  # the request is in mHz
        elif request == START and value:
            self.stream, self.index, self.sent, self.overruns, self._ready = value, 0, 0, 0, b""
        elif request == STOP:
            self.stream, self._ready = 0, b""
        else:
            raise Halted
        return b""

    @property
    def rows(self) -> int:
        """Number of samples per channel in a frame: it is queued when it is full, or 50 ms after its first sample."""
        return min(self.layout.rows, 1 + int(self.rate * MAX_FRAME_DURATION_S))

    def send(self, size: int) -> bytes:
        """Return the bytes for a read of ``size`` bytes; none while no stream runs."""
        missing = size - len(self._ready)
        if self.stream and missing > 0:
            self._ready += self.build_frames(-(-missing // self.layout.size))  # rounded up to whole frames
        data, self._ready = self._ready[:size], self._ready[size:]
        return data

    def build_frames(self, count: int, flags: int = 0) -> bytes:
        """Return the bytes of the next ``count`` frames, all with the same flags."""
        rows = self.rows
        index = self.index + np.arange(count * rows)
        counts = np.rint(self._signals(index / self.rate) / self._scale)
        codes: Codes = np.clip(counts, MIN_CODE, MAX_CODE).astype(np.int16)
        data = b"".join(
            encode_frame(
                self.layout,
                codes[k * rows : (k + 1) * rows],
                stream=self.stream,
                sequence=self.sent + k,
                index=self.index + k * rows,
                flags=flags,
            )
            for k in range(count)
        )
        self.index += count * rows
        self.sent += count
        return data
