"""Read the vendor stream over USB, with recovery: lost samples become a gap.

A halted endpoint is cleared and the stream continues. A failing bus is tried once more, then the device is searched again. A
disconnected device is searched by its serial number, at any address. If it still counts the same stream, the gap's length
follows from its counter. If not, a new stream is started and the gap's length is unknown.
"""

from __future__ import annotations

import random
import time
from array import array
from dataclasses import dataclass
from functools import partial

from usb.backend import IBackend
from usb.core import USBError

from hw.common.errors import AccessDenied, Busy, Disconnected, HardwareError, InvalidSource, ProtocolError, Stalled, Timeout
from hw.common.samples import CHANNEL_NAMES
from hw.common.transport import Chunk, Header, make_timestamp
from hw.usb.device import UsbDevice
from hw.usb.faults import classify_fault, translate_fault
from hw.usb.find import Backends, find_probe, open_libusb
from hw.wire.frames import FrameLayout

_USB_FAULTS = (USBError, NotImplementedError)
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


class UsbTransport:
    """A transport that reads one probe on USB.

    Parameters
    ----------
    serial
        The probe's serial number; None: the only one connected.
    rate
        Requested rate, Hz; None: the present rate.
    backend
        Of pyusb, in place of libusb.
    patience
        Time limits and numbers of attempts.

    Raises
    ------
    HardwareError
        No such probe, several, busy, access denied, or not a probe.
    """

    def __init__(
        self,
        serial: str | None = None,
        rate: float | None = None,
        backend: IBackend | None = None,
        patience: Patience = DEFAULT_PATIENCE,
    ) -> None:
        self._backends: Backends = open_libusb if backend is None else partial(_return_backend, backend)
        self._name = "usb" if backend is None else "virtual"
        self._patience = patience
        if rate is not None and not 1e-3 <= rate <= 4e6:
            raise InvalidSource(f"rate = {rate} Hz: allowed: 0.001 to 4000000 Hz")
        # a random stream number, so that frames of an earlier stream are recognised
        self._stream, self._failures, self._heard = random.randint(1, 0xFFFF), 0, time.monotonic()
        self._fault: Exception | None = None  # of the last read; recovery comes with the next, after its data were returned
        self._note, self._started = "", False
        self._device = self._open_device(serial)
        try:
            self.header = self._begin(rate)
        except _USB_FAULTS as fault:
            self._device.close()
            if classify_fault(fault) is Stalled:
                raise ProtocolError(
                    f"{self._subject} refuses the requests of docs/reference/protocol.md: correct its firmware"
                ) from fault
            raise translate_fault(fault, self._subject) from fault
        except HardwareError:
            self._device.close()
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
            self._start()
        if self._fault is not None:
            self._note, self._fault = self._recover(self._fault) or self._note, None
        buffer = array("B", bytes(self._size))
        try:
            data = self._device.read(buffer, round(1e3 * self._patience.read))
        except _USB_FAULTS as fault:
            self._fault, data = fault, _salvage_packets(buffer, self._device.packet)
        if data:
            self._failures, self._heard = 0, time.monotonic()
        note, self._note = self._note, "" if data else self._note
        return Chunk(data, self._stream, note, time.monotonic())

    def close(self) -> None:
        """Stop the stream and release the device."""
        self._device.close()

    @property
    def _subject(self) -> str:
        return f"probe {self._device.serial}".rstrip()

    def _open_device(self, serial: str | None) -> UsbDevice:
        try:
            return UsbDevice(find_probe(serial, self._backends))
        except _USB_FAULTS as fault:
            raise translate_fault(fault, f"probe {serial or 'on USB'}") from fault

    def _begin(self, rate: float | None) -> Header:
        """Stop a running stream, set the rate and return the header."""
        self._device.stop()  # a killed program may have left it running
        if rate is not None:
            self._device.set_rate(rate)
        info, packet = self._device.read_info(), self._device.packet
        layout = FrameLayout(packet, info.channels)
        frames = max(1, round(self._patience.span * info.rate / layout.rows))
        self._size = min(frames, self._patience.largest // packet) * packet
        source: dict[str, object] = {
            "transport": self._name, "serial": self._device.serial, "firmware": info.firmware, "place": self._device.place,
            "started": make_timestamp(), "scale": list(info.scale),
        }  # fmt: skip
        return Header(
            "frames",
            info.rate,
            channels=CHANNEL_NAMES[: info.channels],
            scale=info.scale,
            size=packet,
            stream=self._stream,
            source=source,
        )

    def _start(self) -> None:
        try:
            self._device.start(self._stream)
        except _USB_FAULTS as fault:
            raise translate_fault(fault, self._subject) from fault
        self._started, self._heard = True, time.monotonic()
        self.header.source["started"] = make_timestamp()

    def _recover(self, fault: Exception) -> str:
        """Recover the stream and return the reason of the gap; raise if recovery fails."""
        kind, place = classify_fault(fault), self._device.place
        if kind is Timeout and not self._is_stream_lost():
            self._check_silence(fault)
            return ""
        self._failures += 1
        if self._failures > self._patience.attempts:
            raise translate_fault(fault, self._subject) from fault
        try:
            if kind is Stalled:
                self._device.clear_halt()
            elif kind is Disconnected or self._failures > 1:  # an unplug may show as a failing bus first
                self._reopen(fault)
            self._resume()
        except _USB_FAULTS as another:
            return self._recover(another)
        reason = _GAP_REASONS.get(kind, "the bus failed")
        return reason if self._device.place == place else f"{reason}, and came back at {self._device.place}"

    def _is_stream_lost(self) -> bool:
        """Whether the board has ended this stream without leaving the bus, after a reset or a short loss of power."""
        try:
            return self._device.read_status().stream != self._stream
        except (*_USB_FAULTS, ProtocolError):  # no response to this either: the device is silent
            return False

    def _check_silence(self, fault: Exception) -> None:
        if time.monotonic() - self._heard > self._patience.silence:
            raise translate_fault(fault, self._subject) from fault

    def _resume(self) -> None:
        """Continue the stream if the device still counts it; start another if not."""
        if self._device.read_status().stream != self._stream:
            self._stream = self._stream % 0xFFFF + 1
            self._device.start(self._stream)
        self._heard = time.monotonic()

    def _reopen(self, fault: Exception) -> None:
        """Find the device again by its serial number, at any address."""
        serial = self._device.serial
        self._device.close(stop=False)
        limit = time.monotonic() + self._patience.absence
        while True:
            try:
                self._device = self._open_device(serial)
                return
            except HardwareError as missing:  # access may be given a moment after it came back
                if time.monotonic() > limit:
                    raise (
                        missing
                        if isinstance(missing, AccessDenied | Busy)
                        else translate_fault(fault, self._subject, Disconnected)
                    ) from fault
            time.sleep(0.05)


def _salvage_packets(buffer: array[int], packet: int) -> bytes:
    """Return the bytes that a failed read received before the fault; the frames' checksums exclude wrong ones.

    Trailing zeros are cut only to a multiple of the packet size, because one checksum in 256 ends in a received zero.
    """
    size = len(buffer.tobytes().rstrip(b"\0"))
    return buffer[: -(-size // packet) * packet].tobytes()


def _return_backend(backend: IBackend) -> IBackend:
    return backend
