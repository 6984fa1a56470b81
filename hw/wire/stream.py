"""Read the vendor stream from a device on any bus, with recovery: lost samples become a gap.

A halted endpoint is cleared and the stream continues. A failing bus is tried once more, then the device is opened again. A
disconnected device is opened again by its serial number at any address, or by the name of its port. If it still counts the same
stream, the gap's length follows from its counter. If not, a new stream is started and the gap's length is unknown.
"""

from __future__ import annotations

import random
import time
from dataclasses import dataclass
from typing import Protocol

from hw.common.errors import AccessDenied, Busy, Disconnected, HardwareError, InvalidSource, ProtocolError, Stalled, Timeout
from hw.common.samples import CHANNEL_NAMES
from hw.common.transport import Chunk, Header, make_timestamp
from hw.wire.frames import FrameLayout
from hw.wire.protocol import GET_INFO, GET_STATUS, SET_RATE, START, STOP, Info, Status

MIN_RATE_HZ, MAX_RATE_HZ = 1e-3, 4e6  # Hz, what a request can hold
_GAP_REASONS: dict[type[HardwareError], str] = {
    Stalled: "the endpoint was halted", Disconnected: "the device was unplugged", Timeout: "the device was reset",
}  # fmt: skip


@dataclass(frozen=True)
class Patience:
    """Time limits and numbers of attempts.

    Attributes
    ----------
    read
        Timeout of one read, s.
    silence
        Time without a byte after which it gives up, s.
    absence
        Time after a disconnection after which it gives up, s.
    attempts
        Consecutive recoveries.
    span
        Duration of the samples in one read at most, s.
    largest
        Bytes in one read at most.
    """

    read: float = 0.5
    silence: float = 3.0
    absence: float = 10.0
    attempts: int = 3
    span: float = 0.05
    largest: int = 1 << 16


DEFAULT_PATIENCE = Patience()


class ProbeDevice(Protocol):
    """A probe on some bus; every method but ``close`` raises ``HardwareError``.

    Attributes
    ----------
    subject
        Names the device in messages.
    place
        Where it is connected.
    packet
        Bytes of a packet on the bus, which is also the size of frames; 0 where the device states that size.
    wake_seconds
        Time for which it may miss requests after it was opened, s.
    """

    subject: str
    place: str
    packet: int
    wake_seconds: float

    def open(self) -> None:
        """Open the device, for the first time or again after ``close``."""

    def describe(self) -> dict[str, object]:
        """Return what identifies the device, for the header."""

    def request(self, number: int, value: int = 0, data: int = 0) -> bytes:
        """Send a request, and return the data of its response."""

    def read(self, size: int, seconds: float) -> tuple[bytes, HardwareError | None]:
        """Return at most ``size`` bytes that came within ``seconds``, and the fault that ended the read, if there was one."""

    def clear_halt(self) -> None:
        """End a halt of the endpoint."""

    def close(self, stop: bool = True) -> None:
        """Stop the stream if ``stop`` is true, and release the device, whatever state it is in; never raises."""


class StreamTransport:
    """A transport that reads one probe.

    Parameters
    ----------
    device
        The probe, which is opened here.
    rate
        Requested rate, Hz; None: the present rate.
    patience
        Time limits and numbers of attempts.

    Raises
    ------
    InvalidSource
        The rate is out of range.
    HardwareError
        No such probe, several, busy, access denied, or not a probe.
    """

    def __init__(self, device: ProbeDevice, rate: float | None = None, patience: Patience = DEFAULT_PATIENCE) -> None:
        """Open the device and set the rate; the stream starts at the first read."""
        if rate is not None and not MIN_RATE_HZ <= rate <= MAX_RATE_HZ:
            raise InvalidSource(f"rate = {rate} Hz: allowed: {MIN_RATE_HZ:g} to {MAX_RATE_HZ:.0f} Hz")
        self._device, self._patience = device, patience
        # a random stream number, so that frames of an earlier stream are recognised
        self._stream, self._failures, self._last_data_time = random.randint(1, 0xFFFF), 0, time.monotonic()
        self._fault: HardwareError | None = None  # of the last read; recovery comes with the next, after its data were returned
        self._note, self._started = "", False
        device.open()
        try:
            self.header = self._prepare(rate)
        except HardwareError as fault:
            device.close()
            if isinstance(fault, Stalled):
                text = f"{device.subject} refuses the requests of docs/reference/protocol.md: correct its firmware"
                raise ProtocolError(text) from fault
            raise

    def read(self) -> Chunk:
        """Return the bytes of the next read, empty if none came in time. After a fault the next call recovers.

        The first call starts the stream. Calls must follow without delay, since the board's buffer holds 0.1 s.

        Raises
        ------
        HardwareError
            Recovery failed, or no byte came for ``Patience.silence`` s.
        """
        if not self._started:
            self._device.request(START, self._stream)
            self._started, self._last_data_time = True, time.monotonic()
            self.header.source["started"] = make_timestamp()
        if self._fault is not None:
            self._note = self._recover(self._fault) or self._note
        data, self._fault = self._device.read(self._read_size, self._patience.read)
        if data:
            self._failures, self._last_data_time = 0, time.monotonic()
        note, self._note = self._note, "" if data else self._note
        return Chunk(data, self._stream, note, time.monotonic())

    def close(self) -> None:
        """Stop the stream and release the device."""
        self._device.close()

    def _prepare(self, rate: float | None) -> Header:
        """Stop a running stream, set the rate and return the header."""
        self._stop_stream()
        if rate is not None:
            self._device.request(SET_RATE, data=round(1e3 * rate))  # mHz
        info = Info.decode(self._device.request(GET_INFO))
        layout = FrameLayout(self._device.packet or info.frame_size, info.channels)
        frames = max(1, round(self._patience.span * info.rate / layout.rows))  # in one read
        self._read_size = min(frames, self._patience.largest // layout.size) * layout.size
        source = self._device.describe() | {
            "firmware": info.firmware, "started": make_timestamp(), "scale": list(info.scale)
        }  # fmt: skip
        channels = CHANNEL_NAMES[: info.channels]
        return Header("frames", info.rate, channels, info.scale, size=layout.size, stream=self._stream, source=source)

    def _stop_stream(self) -> None:
        """Stop a stream that a killed program may have left running; repeat, since a restarting board misses requests."""
        end = time.monotonic() + self._device.wake_seconds
        while True:
            try:
                self._device.request(STOP)
                return
            except Timeout:
                if time.monotonic() > end:
                    raise

    def _recover(self, fault: HardwareError) -> str:
        """Recover the stream after a fault; return the reason of the gap, "" if none is expected; raise if recovery fails."""
        kind, place = type(fault), self._device.place
        if kind is Timeout and not self._is_stream_lost():
            if time.monotonic() - self._last_data_time > self._patience.silence:
                raise fault
            return ""
        self._failures += 1
        if self._failures > self._patience.attempts:
            raise fault
        if kind is Disconnected or (kind is not Stalled and self._failures > 1):  # an unplug may show as a failing bus first
            self._reopen(fault)
        try:
            if kind is Stalled:
                self._device.clear_halt()
            self._resume()
        except ProtocolError:
            raise
        except HardwareError as another:
            return self._recover(another)
        reason = _GAP_REASONS.get(kind, "the bus failed")
        return reason if self._device.place == place else f"{reason}, and came back at {self._device.place}"

    def _is_stream_lost(self) -> bool:
        """Whether the board has ended this stream without leaving the bus, after a reset or a short loss of power."""
        try:
            return Status.decode(self._device.request(GET_STATUS)).stream != self._stream
        except HardwareError:  # no response to this either: the device is silent
            return False

    def _resume(self) -> None:
        """Continue the stream if the device still runs it; start another if not, with the next number from 1 to 65535."""
        if Status.decode(self._device.request(GET_STATUS)).stream != self._stream:
            self._stream = self._stream % 0xFFFF + 1
            self._device.request(START, self._stream)
        self._last_data_time = time.monotonic()

    def _reopen(self, fault: HardwareError) -> None:
        """Open the device again; raise if that fails for ``Patience.absence`` s. ``fault`` is the reason for opening it."""
        self._device.close(stop=False)
        end = time.monotonic() + self._patience.absence
        while True:
            try:
                self._device.open()
            except HardwareError as missing:  # access may be given a moment after it came back
                if time.monotonic() > end:
                    if isinstance(missing, AccessDenied | Busy):
                        raise
                    text = f"{self._device.subject}: it went away and did not come back: check plug and cable, then read again"
                    raise Disconnected(f"{text} ({' '.join(str(fault.__cause__).split())})") from fault.__cause__
                time.sleep(0.05)
            else:
                self._last_data_time = time.monotonic()
                return
