"""One open probe on USB: claimed interface, bulk endpoint, control requests. Raises what pyusb raises."""

from __future__ import annotations

from array import array
from typing import Any

import usb.core
import usb.util

from hw.common.errors import ProtocolError
from hw.usb.find import FoundDevice, release, stream_endpoint, where
from hw.wire.protocol import GET_INFO, GET_STATUS, IN, OUT, RATE, SET_RATE, START, STOP, Info, Status

_CONTROL_TIMEOUT = 1000  # ms


class UsbDevice:
    """A probe that was found, opened for this program alone.

    Attributes:
        packet: wMaxPacketSize of its endpoint, which is also the size of its frames.

    Raises:
        ProtocolError: it has no vendor interface with a bulk endpoint.
        usb.core.USBError: it cannot be opened or claimed.
    """

    def __init__(self, connected: FoundDevice) -> None:
        self._device, self.serial = connected.device, connected.serial
        self.place = where(connected.device)
        try:
            self._interface, self._endpoint = self._stream_endpoint()
            self.packet = int(self._endpoint.wMaxPacketSize)
            usb.util.claim_interface(self._device, self._interface)
        except BaseException:
            release([self._device])
            raise

    def read(self, buffer: array[int], timeout: int) -> bytes:
        """Return what the endpoint sent within ``timeout`` ms, a full buffer at most; fewer if time ran out in between.

        When it raises, what came before the fault is in the buffer; how much, pyusb does not tell.
        """
        count = self._device.read(self._endpoint.bEndpointAddress, buffer, timeout)
        return buffer.tobytes() if count == len(buffer) else buffer[:count].tobytes()

    def info(self) -> Info:
        """Return what the device says of itself."""
        return Info.decoded(self._ask(GET_INFO))

    def status(self) -> Status:
        """Return what the device is doing."""
        return Status.decoded(self._ask(GET_STATUS))

    def set_rate(self, rate: float) -> None:
        """Ask for a rate, Hz; the device takes the nearest it can."""
        self._tell(SET_RATE, data=RATE.pack(round(1e3 * rate)))

    def start(self, stream: int) -> None:
        """Begin a new stream."""
        self._tell(START, stream)

    def stop(self) -> None:
        """End the stream."""
        self._tell(STOP)

    def clear_halt(self) -> None:
        """End a halt of the endpoint."""
        self._device.clear_halt(self._endpoint)

    def close(self, stop: bool = True) -> None:
        """Stop the stream and let go of the device, whatever state it is in."""
        try:
            if stop:
                self.stop()
        except (usb.core.USBError, NotImplementedError):
            pass
        release([self._device])

    def _stream_endpoint(self) -> tuple[Any, Any]:
        try:
            configuration = self._device.get_active_configuration()
        except usb.core.USBError:  # not configured yet
            self._device.set_configuration()
            configuration = self._device.get_active_configuration()
        if (found := stream_endpoint(configuration)) is not None:
            return found
        raise ProtocolError(f"the device at {self.place} has no vendor interface with a bulk IN endpoint: it is not a probe")

    def _ask(self, request: int) -> bytes:
        return bytes(self._device.ctrl_transfer(IN, request, 0, 0, 64, _CONTROL_TIMEOUT))

    def _tell(self, request: int, value: int = 0, data: bytes | None = None) -> None:
        self._device.ctrl_transfer(OUT, request, value, 0, data, _CONTROL_TIMEOUT)
