"""Provide a virtual probe: a backend of pyusb, so that everything above USB runs as with a real probe.

It bypasses libusb and does not test it; the tests under umockdev do.
"""

# pyusb's class IBackend documents the methods and their parameters

from __future__ import annotations

import errno
import struct
import time
from array import array
from collections.abc import Callable, Iterator
from types import SimpleNamespace

from usb.backend import IBackend
from usb.core import USBError, USBTimeoutError

from hw.common.samples import Floats
from hw.simulation.firmware import Firmware, Halted
from hw.wire.protocol import PRODUCT_ID, VENDOR_CLASS, VENDOR_ID

_BUS_ADDRESS, _ENDPOINT_ADDRESS = 2, 0x81
_DEVICE_DESCRIPTOR: dict[str, object] = {
    "bLength": 18, "bDescriptorType": 1, "bcdUSB": 0x0210, "bDeviceClass": 0, "bDeviceSubClass": 0, "bDeviceProtocol": 0,
    "bMaxPacketSize0": 64, "idVendor": VENDOR_ID, "idProduct": PRODUCT_ID, "bcdDevice": 0x0100, "iManufacturer": 1, "iProduct": 2,
    "iSerialNumber": 3, "bNumConfigurations": 1, "bus": 1, "port_number": 1, "port_numbers": (1,), "speed": 3,
}  # fmt: skip
_CONFIGURATION_DESCRIPTOR: dict[str, object] = {
    "bLength": 9, "bDescriptorType": 2, "wTotalLength": 25, "bNumInterfaces": 1, "bConfigurationValue": 1, "iConfiguration": 0,
    "bmAttributes": 0x80, "bMaxPower": 50, "extra_descriptors": [],
}  # fmt: skip
_INTERFACE_DESCRIPTOR: dict[str, object] = {
    "bLength": 9, "bDescriptorType": 4, "bInterfaceNumber": 0, "bAlternateSetting": 0, "bNumEndpoints": 1,
    "bInterfaceClass": VENDOR_CLASS, "bInterfaceSubClass": 0, "bInterfaceProtocol": 0, "iInterface": 0, "extra_descriptors": [],
}  # fmt: skip
_ENDPOINT_DESCRIPTOR: dict[str, object] = {
    "bLength": 7, "bDescriptorType": 5, "bEndpointAddress": _ENDPOINT_ADDRESS, "bmAttributes": 2, "bInterval": 0, "bRefresh": 0,
    "bSynchAddress": 0, "extra_descriptors": [],
}  # fmt: skip


class VirtualProbe(IBackend):  # type: ignore[misc]
    """One virtual probe on a virtual bus; ``make_virtual_probe`` makes it.

    Attributes
    ----------
    serial
        Its serial number.
    firmware
        The simulated device.
    """

    def __init__(self, firmware: Firmware, serial: str, pace: bool) -> None:
        """Connect a simulated device; with ``pace`` its samples come in real time."""
        super().__init__()
        self.serial, self.firmware, self._pace = serial, firmware, pace
        self._begin = time.monotonic()

    def enumerate_devices(self) -> Iterator[int]:
        """Yield the only device: its address stands for it."""
        yield _BUS_ADDRESS

    def get_device_descriptor(self, dev: int) -> SimpleNamespace:
        """Return the descriptor of the device."""
        return SimpleNamespace(**_DEVICE_DESCRIPTOR, address=dev)

    def get_configuration_descriptor(self, dev: int, config: int) -> SimpleNamespace:
        """Return the descriptor of configuration 0; ``IndexError`` ends pyusb's search for others."""
        if config:
            raise IndexError(config)
        return SimpleNamespace(**_CONFIGURATION_DESCRIPTOR)

    def get_interface_descriptor(self, dev: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        """Return the descriptor of interface 0; ``IndexError`` ends pyusb's search for others."""
        if intf or alt:
            raise IndexError((intf, alt))
        return SimpleNamespace(**_INTERFACE_DESCRIPTOR)

    def get_endpoint_descriptor(self, dev: int, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        """Return the descriptor of the only endpoint, whose packets have the size of a frame."""
        return SimpleNamespace(**_ENDPOINT_DESCRIPTOR, wMaxPacketSize=self.firmware.layout.size)

    def open_device(self, dev: int) -> int:
        """Return the device as its own handle."""
        return dev

    def close_device(self, dev_handle: int) -> None:
        """Do nothing: no device is open."""

    def get_configuration(self, dev_handle: int) -> int:
        """Return the number of the only configuration."""
        return 1

    def claim_interface(self, dev_handle: int, intf: int) -> None:
        """Do nothing: no other program can claim it."""

    def release_interface(self, dev_handle: int, intf: int) -> None:
        """Do nothing: no other program waits for it."""

    def ctrl_transfer(
        self, dev_handle: int, bmRequestType: int, bRequest: int, wValue: int, wIndex: int, data: array[int], timeout: int
    ) -> int:
        """Respond to a control request: put its data into ``data``, or take them from there; return their length."""
        if (bmRequestType, bRequest, wValue) == (0x80, 6, 0x0303):  # GET_DESCRIPTOR, string 3: the serial number
            text = self.serial.encode("utf-16-le")
            return _fill_buffer(data, struct.pack("BB", 2 + len(text), 3) + text)
        try:
            # bit 0x80: from the device to the host
            answer = self.firmware.control(bRequest, wValue, bytes(data) if not bmRequestType & 0x80 else b"")
        except Halted as refused:
            raise USBError("Pipe error", -9, errno.EPIPE) from refused
        self._begin = time.monotonic() if self.firmware.sent == 0 else self._begin  # the stream begins now, at the earliest
        return _fill_buffer(data, answer) if bmRequestType & 0x80 else len(data)

    def bulk_read(self, dev_handle: int, ep: int, intf: int, buff: array[int], timeout: int) -> int:
        """Fill ``buff`` with bytes of the stream, and return their number; time out while no stream runs."""
        data = self.firmware.send(len(buff) * buff.itemsize)
        if not data:
            raise USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        self._wait()
        return _fill_buffer(buff, data)

    def _wait(self) -> None:
        """Wait until the time at which a real device would have taken the last sample sent, if the probe is in real time."""
        if self._pace:
            time.sleep(max(0.0, self._begin + self.firmware.index / self.firmware.rate - time.monotonic()))


def make_virtual_probe(
    signals: Callable[[Floats], Floats],
    rate: float,
    serial: str = "VIRTUAL",
    *,
    channels: int = 2,
    scale: float = 1e-4,
    packet: int = 512,
    pace: bool = False,
) -> VirtualProbe:
    """Make a virtual probe, for ``hw.reader.Reader.open``.

    Parameters
    ----------
    signals
        Function from (n,) times since the start of the stream, s, to (n, channels) volts.
    rate
        Sampling rate, Hz.
    serial
        Its serial number.
    channels
        2, or 3 with a force.
    scale
        Volts per count; the range is 32767 counts to either side.
    packet
        Bytes in a frame.
    pace
        Deliver samples in real time; if false, as fast as they are read.
    """
    return VirtualProbe(Firmware(signals, rate, (scale,) * channels, packet), serial, pace)


def _fill_buffer(buffer: array[int], data: bytes) -> int:
    """Copy data into a buffer; return how many bytes fit."""
    size = min(len(data), len(buffer) * buffer.itemsize)
    memoryview(buffer).cast("B")[:size] = data[:size]
    return size
