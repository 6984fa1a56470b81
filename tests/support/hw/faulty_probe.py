"""A virtual probe with faults at chosen frames: on the bus, in the device, or of the plug."""

from __future__ import annotations

import errno
import time
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from usb.core import USBError, USBTimeoutError

from hw.common.samples import Floats
from hw.simulation.firmware import Firmware, Halted
from hw.simulation.virtual import VirtualProbe
from hw.wire.frames import OVERRUN_FLAG
from hw.wire.protocol import START

Kind = Literal["drop", "repeat", "corrupt", "cut", "overrun", "stall", "error", "silence", "reset", "unplug", "power"]


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


class FaultyFirmware(Firmware):
    """Firmware with faults; ``halted`` states whether the endpoint is halted."""

    def __init__(
        self, signals: Callable[[Floats], Floats], rate: float, scale: tuple[float, ...], packet: int, faults: Sequence[Fault]
    ) -> None:
        super().__init__(signals, rate, scale, packet)
        self.halted = False
        self._faults = sorted(faults, key=lambda fault: fault.frame)
        self._failing: list[Kind] = []
        self._absence, self._away_until = 0.0, 0.0
        self._made = 0  # frames since power-up; ``Fault.frame`` refers to it

    def is_absent(self) -> bool:
        """Whether the device is unplugged at present."""
        return time.monotonic() < self._away_until

    def control(self, request: int, value: int, data: bytes) -> bytes:
        response = super().control(request, value, data)
        if request == START:
            self.halted = False
        return response

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
            self._ready += self.build_frames(min(count, until))
            return
        fault = self._faults.pop(0)
        if fault.kind in ("drop", "repeat", "corrupt", "cut", "overrun"):
            self._ready += self._spoil_frames(fault)
        else:
            self._failing, self._absence = [fault.kind] * fault.count, fault.seconds

    def _spoil_frames(self, fault: Fault) -> bytes:
        if fault.kind == "overrun":
            self.index += fault.count * self.rows
            self.overruns += 1
            return self.build_frames(1, OVERRUN_FLAG)
        frames = self.build_frames(fault.count)
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
        self.index += self.rows
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

    def build_frames(self, count: int, flags: int = 0) -> bytes:
        self._made += count
        return super().build_frames(count, flags)


class FaultyProbe(VirtualProbe):
    """A virtual probe whose faults become errors of libusb."""

    firmware: FaultyFirmware

    def __init__(self, firmware: FaultyFirmware, serial: str) -> None:
        super().__init__(firmware, serial, pace=False)
        self._address = 2

    def enumerate_devices(self) -> Iterator[int]:
        if not self.firmware.is_absent():
            yield self._address

    def clear_halt(self, dev_handle: int, ep: int) -> None:
        self._check_present(dev_handle)
        self.firmware.halted = False

    def ctrl_transfer(self, dev_handle: int, *arguments: int | array[int]) -> int:
        self._check_present(dev_handle)
        return super().ctrl_transfer(dev_handle, *arguments)  # type: ignore[arg-type]

    def bulk_read(self, dev_handle: int, ep: int, intf: int, buff: array[int], timeout: int) -> int:
        self._check_present(dev_handle)
        size = len(buff) * buff.itemsize
        try:
            data = self.firmware.send(size)
            memoryview(buff).cast("B")[: len(data)] = data
            if data and len(data) < size:  # a short transfer ends with its fault, as in libusb
                self.firmware.send(size)
        except Halted as stall:
            raise USBError("Pipe error", -9, errno.EPIPE) from stall
        except OSError as fault:
            if fault.errno == errno.ENODEV:
                self._address += 1
                raise USBError("No such device (it may have been disconnected)", -4, errno.ENODEV) from fault
            raise USBError("Input/Output Error", -1, errno.EIO) from fault
        if not data:
            raise USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        return len(data)

    def _check_present(self, address: int) -> None:
        if address != self._address or self.firmware.is_absent():
            raise USBError("No such device (it may have been disconnected)", -4, errno.ENODEV)


def make_faulty_probe(
    signals: Callable[[Floats], Floats],
    rate: float,
    serial: str = "VIRTUAL",
    *,
    faults: Sequence[Fault] = (),
    channels: int = 2,
    scale: float = 1e-4,
    packet: int = 512,
) -> VirtualProbe:
    """Make a virtual probe with faults; see ``hw.simulation.virtual.make_virtual_probe``."""
    return FaultyProbe(FaultyFirmware(signals, rate, (scale,) * channels, packet, faults), serial)
