"""Communicate with one probe on USB: claimed interface, bulk endpoint, control requests."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import usb.core
import usb.util
from usb.backend import IBackend

from hw.common.errors import HardwareError, ProtocolError
from hw.usb.faults import translate_fault
from hw.usb.find import describe_address, find_probe, find_stream_endpoint, open_libusb, release
from hw.wire.protocol import RATE_FORMAT, REQUEST_IN, REQUEST_OUT, SET_RATE, START, STOP

_CONTROL_TIMEOUT = 1000  # ms
_USB_FAULTS = (usb.core.USBError, NotImplementedError)


class UsbDevice:
    """A probe on USB; see ``hw.wire.stream.ProbeDevice``.

    Parameters
    ----------
    serial
        The probe's serial number; None: the only one connected.
    backend
        Of pyusb, in place of libusb.
    """

    wake_seconds = 0.0

    def __init__(self, serial: str | None = None, backend: IBackend | None = None) -> None:
        """Store the choice; ``open`` finds the device."""
        self._serial, self._backend = serial, backend
        self.subject = f"probe {serial or 'on USB'}"

    def open(self) -> None:
        """Find the device at any address, open it and claim its interface.

        Raises
        ------
        ProtocolError
            The device has no vendor interface with a bulk endpoint.
        HardwareError
            No such probe, several, busy or access denied.
        """
        with self._translate_faults():
            probe = find_probe(self._serial, lambda: self._backend or open_libusb())
            self._device, self._serial, self.place = probe.device, probe.serial, describe_address(probe.device)
            try:
                interface, self._endpoint = self._find_endpoint()
                usb.util.claim_interface(self._device, interface)
            except BaseException:
                release([self._device])
                raise
        self.packet = int(self._endpoint.wMaxPacketSize)
        self.subject = f"probe {self._serial}".rstrip()

    def describe(self) -> dict[str, object]:
        """Return transport, serial number and place."""
        return {"transport": "usb" if self._backend is None else "virtual", "serial": self._serial, "place": self.place}

    def request(self, number: int, value: int = 0, data: int = 0) -> bytes:
        """Send a control request, and return the data of its response, empty for those that only set something."""
        with self._translate_faults():
            if number in (SET_RATE, START, STOP):
                content = RATE_FORMAT.pack(data) if number == SET_RATE else None
                self._device.ctrl_transfer(REQUEST_OUT, number, value, 0, content, _CONTROL_TIMEOUT)
                return b""
            return bytes(self._device.ctrl_transfer(REQUEST_IN, number, value, 0, 64, _CONTROL_TIMEOUT))

    def read(self, size: int, seconds: float) -> tuple[bytes, HardwareError | None]:
        """Return at most ``size`` bytes that came within ``seconds``, and the fault that ended the read, if there was one."""
        buffer = array("B", bytes(size))
        try:
            with self._translate_faults():
                count = self._device.read(self._endpoint.bEndpointAddress, buffer, round(1e3 * seconds))
                return buffer[:count].tobytes(), None
        except HardwareError as fault:
            return _salvage_packets(buffer, self.packet), fault

    def clear_halt(self) -> None:
        """End a halt of the endpoint."""
        with self._translate_faults():
            self._device.clear_halt(self._endpoint)

    def close(self, stop: bool = True) -> None:
        """Stop the stream if ``stop`` is true, and release the device, whatever state it is in."""
        if stop:
            with suppress(HardwareError):
                self.request(STOP)
        release([self._device])

    def _find_endpoint(self) -> tuple[usb.core.Interface, usb.core.Endpoint]:
        """Return number and endpoint of the stream's interface; configure the device if it is not configured yet."""
        try:
            configuration = self._device.get_active_configuration()
        except usb.core.USBError:
            self._device.set_configuration()
            configuration = self._device.get_active_configuration()
        if (endpoint := find_stream_endpoint(configuration)) is not None:
            return endpoint
        raise ProtocolError(f"the device at {self.place} has no vendor interface with a bulk IN endpoint: it is not a probe")

    @contextmanager
    def _translate_faults(self) -> Iterator[None]:
        """Translate exceptions of pyusb into ``HardwareError``."""
        try:
            yield
        except _USB_FAULTS as fault:
            raise translate_fault(fault, self.subject) from fault


def _salvage_packets(buffer: array[int], packet: int) -> bytes:
    """Return the bytes that a failed read received before the fault; the frames' checksums exclude wrong ones.

    pyusb does not report how many bytes came; the buffer was filled with zeros before. The zeros at its end are cut off, except
    those in the last packet that holds other bytes, because one checksum in 256 ends in a zero that was received.
    """
    size = len(buffer.tobytes().rstrip(b"\0"))
    return buffer[: -(-size // packet) * packet].tobytes()
