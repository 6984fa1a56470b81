"""Model the firmware of ``docs/reference/protocol.md``, with faults at chosen frames, for the virtual probe."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hw.common.samples import Floats
from hw.wire.frames import MAX_CODE, MIN_CODE, OVERRUN_FLAG, Codes, FrameLayout, encode_frame
from hw.wire.protocol import GET_INFO, GET_STATUS, RATE_FORMAT, SET_RATE, START, STOP, Info, Status

Kind = Literal["drop", "repeat", "corrupt", "cut", "overrun", "stall", "error", "silence", "reset", "unplug", "power"]


class Halted(Exception):  # noqa: N818 - a state of the endpoint
    """The endpoint is halted, or the request refused."""


@dataclass(frozen=True)
class Fault:
    """A fault that occurs once.

    Attributes
    ----------
    kind
        "drop" frames on the bus, "repeat" them, "corrupt" a bit in each, "cut" the first short, "overrun" in the device, "stall"
        the endpoint, bus "error", "silence" (reads time out), "reset" (the device stays, but loses its stream), "unplug" while
        the device counts on, "power" (unplug, and the counter restarts).
    frame
        Number of the first frame concerned.
    count
        Number of frames lost or damaged, or of consecutive reads that fail.
    seconds
        Time for which an unplugged device stays away.
    """

    kind: Kind
    frame: int
    count: int = 1
    seconds: float = 0.0


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
    halted
        Whether the endpoint is halted.
    """

    def __init__(
        self, signals: Callable[[Floats], Floats], rate: float, scale: tuple[float, ...], packet: int, faults: Sequence[Fault]
    ) -> None:
        self.layout, self.rate = FrameLayout(packet, len(scale)), rate
        self._signals, self._scale = signals, np.array(scale, np.float32).astype(float)  # as GET_INFO tells it
        self._highest = rate
        self.stream, self.index, self.sent, self.overruns, self.halted = 0, 0, 0, 0, False
        self._faults = sorted(faults, key=lambda fault: fault.frame)
        self._failing: list[Kind] = []
        self._ready = b""
        self._absence, self._away_until = 0.0, 0.0
        self._made = 0  # frames since power-up; ``Fault.frame`` refers to it

    def is_absent(self) -> bool:
        """Whether the device is unplugged at present."""
        return time.monotonic() < self._away_until

    def control(self, request: int, value: int, data: bytes) -> bytes:
        """Return the response to a vendor request. Raises ``Halted`` when it is refused."""
        if request == GET_INFO:
            return Info(self.layout.channels, self.rate, self._highest, tuple(self._scale), "virtual 1").encode()
        if request == GET_STATUS:
            return Status(self.stream, self.overruns, self.sent, self.index).encode()
        if request == SET_RATE and not self.stream:
            self.rate = min(self._highest, max(1.0, RATE_FORMAT.unpack(data)[0] / 1e3))
        elif request == START and value:
            self.stream, self.index, self.sent, self.overruns, self.halted, self._ready = value, 0, 0, 0, False, b""
        elif request == STOP:
            self.stream = 0
        else:
            raise Halted
        return b""

    def send(self, size: int) -> bytes:
        """Return the bytes for a read of ``size`` bytes. Raises ``Halted``, or ``OSError`` (EIO, ENODEV)."""
        if self._failing and not self._ready:
            self._fail(self._failing.pop())
            return b""
        if self.halted:
            raise Halted
        while self.stream and len(self._ready) < size and not self._failing:
            self._make_frames(-(-(size - len(self._ready)) // self.layout.size))
        if not self._ready and self._failing:
            return self.send(size)
        data, self._ready = self._ready[:size], self._ready[size:]
        return data

    def _make_frames(self, count: int) -> None:
        """Prepare up to ``count`` frames, fewer if a fault comes first; if it is due now, apply the fault."""
        until = self._faults[0].frame - self._made if self._faults else count
        if until > 0:
            self._ready += self._build_frames(min(count, until))
            return
        fault = self._faults.pop(0)
        if fault.kind in ("drop", "repeat", "corrupt", "cut", "overrun"):
            self._ready += self._spoil_frames(fault)
        else:
            self._failing, self._absence = [fault.kind] * fault.count, fault.seconds

    def _spoil_frames(self, fault: Fault) -> bytes:
        if fault.kind == "overrun":
            self.index += fault.count * self.layout.rows
            self.overruns += 1
            return self._build_frames(1, OVERRUN_FLAG)
        frames = self._build_frames(fault.count)
        if fault.kind == "repeat":
            return frames * 2
        if fault.kind == "cut":
            return frames[self.layout.size // 3 :]
        if fault.kind == "corrupt":
            damaged = np.frombuffer(frames, np.uint8).reshape(fault.count, -1).copy()
            damaged[:, 25] ^= 0x10
            return damaged.tobytes()
        return b""

    def _fail(self, kind: Kind) -> None:
        """Perform a failing read: do nothing, or lose a frame and raise."""
        if kind == "silence":
            return
        self.index += self.layout.rows
        self.sent += 1
        if kind == "reset":
            self.stream = 0
            return
        if kind == "stall":
            self.halted = True
            raise Halted
        if kind == "error":
            raise OSError(errno.EIO, "bus error")
        if kind in ("unplug", "power"):
            self._away_until = time.monotonic() + self._absence
            self.stream = 0 if kind == "power" else self.stream
            raise OSError(errno.ENODEV, "unplugged")

    def _build_frames(self, count: int, flags: int = 0) -> bytes:
        rows = self.layout.rows
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
        self._made += count
        return data
