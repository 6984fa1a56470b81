"""Communicate with one open probe on USB: claimed interface, bulk endpoint, control requests. Exceptions are pyusb's."""

from __future__ import annotations

from array import array

import usb.core
import usb.util

from hw.common.errors import ProtocolError
from hw.usb.find import FoundDevice, describe_address, find_stream_endpoint, release
from hw.wire.protocol import GET_INFO, GET_STATUS, RATE_FORMAT, REQUEST_IN, REQUEST_OUT, SET_RATE, START, STOP, Info, Status

_CONTROL_TIMEOUT = 1000  # ms


class UsbDevice:
    """A probe that is open, with its interface claimed by this program.

    Attributes
    ----------
    packet
        wMaxPacketSize of its endpoint, which is also the size of its frames.

    Raises
    ------
    ProtocolError
        The device has no vendor interface with a bulk endpoint.
    usb.core.USBError
        The device cannot be opened or claimed.
    """

    def __init__(self, connected: FoundDevice) -> None:
        self._device, self.serial = connected.device, connected.serial
        self.place = describe_address(connected.device)
        try:
            self._interface, self._endpoint = self._find_endpoint()
            self.packet = int(self._endpoint.wMaxPacketSize)
            usb.util.claim_interface(self._device, self._interface)
        except BaseException:
            release([self._device])
            raise

    def read(self, buffer: array[int], timeout: int) -> bytes:
        """Return the bytes that the endpoint sent within ``timeout`` ms, at most a full buffer.

        If it raises, the bytes before the fault are in the buffer; pyusb does not report their number.
        """
        count = self._device.read(self._endpoint.bEndpointAddress, buffer, timeout)
        return buffer.tobytes() if count == len(buffer) else buffer[:count].tobytes()

    def read_info(self) -> Info:
        """Read the device's description of itself."""
        return Info.decode(self._ask(GET_INFO))

    def read_status(self) -> Status:
        """Read the state of the device's stream."""
        return Status.decode(self._ask(GET_STATUS))

    def set_rate(self, rate: float) -> None:
        """Request a rate, Hz; the device uses the nearest one that it supports."""
        self._send(SET_RATE, data=RATE_FORMAT.pack(round(1e3 * rate)))

    def start(self, stream: int) -> None:
        """Start a new stream."""
        self._send(START, stream)

    def stop(self) -> None:
        """Stop the stream."""
        self._send(STOP)

    def clear_halt(self) -> None:
        """End a halt of the endpoint."""
        self._device.clear_halt(self._endpoint)

    def close(self, stop: bool = True) -> None:
        """Stop the stream and release the device, whatever state it is in."""
        try:
            if stop:
                self.stop()
        except (usb.core.USBError, NotImplementedError):
            pass
        release([self._device])

    def _find_endpoint(self) -> tuple[usb.core.Interface, usb.core.Endpoint]:
        try:
            configuration = self._device.get_active_configuration()
        except usb.core.USBError:  # not configured yet
            self._device.set_configuration()
            configuration = self._device.get_active_configuration()
        if (endpoint := find_stream_endpoint(configuration)) is not None:
            return endpoint
        raise ProtocolError(f"the device at {self.place} has no vendor interface with a bulk IN endpoint: it is not a probe")

    def _ask(self, request: int) -> bytes:
        return bytes(self._device.ctrl_transfer(REQUEST_IN, request, 0, 0, 64, _CONTROL_TIMEOUT))

    def _send(self, request: int, value: int = 0, data: bytes | None = None) -> None:
        self._device.ctrl_transfer(REQUEST_OUT, request, value, 0, data, _CONTROL_TIMEOUT)
