"""Find probes on the bus by vendor, product and serial number."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module

import usb.core
import usb.util
from usb.backend import IBackend, libusb1
from usb.backend.libusb1 import _LibUSB

from hw.common.errors import Ambiguous, HardwareError, NotFound
from hw.usb.faults import translate_fault
from hw.wire.protocol import PRODUCT_ID, VENDOR_CLASS, VENDOR_ID

Backends = Callable[[], IBackend]
_STRING_DESCRIPTOR, _ENGLISH_US = 0x0300, 0x0409


def load_libusb() -> IBackend | None:
    """Return the libusb of libusb-package, or where that is not installed the system's; None where there is none."""
    try:
        package = import_module("libusb_package")
    except ImportError:
        return libusb1.get_backend()
    backend: IBackend | None = package.get_libusb1_backend()
    return backend


@dataclass(frozen=True)
class FoundDevice:
    """A device that looks like a probe.

    Attributes
    ----------
    device
        Pyusb's.
    serial
        Its serial number; empty if it could not be read.
    fault
        Why the serial number could not be read.
    """

    device: usb.core.Device
    serial: str
    fault: Exception | None = None


class _Context(_LibUSB):  # type: ignore[misc]
    """A context of libusb that lives as long as its devices: libusb needs it to release them."""

    def enumerate_devices(self) -> Iterator[usb.core.Device]:
        """Yield the devices, each with a reference to this context."""
        for device in super().enumerate_devices():
            device.context = self
            yield device


def open_libusb() -> IBackend:
    """Open libusb with a new context, which lists the devices that are connected now.

    An existing context learns of new devices through the system's hotplug messages, which do not reach a container. A new
    context scans the bus.

    Raises
    ------
    NotFound
        There is no libusb for this machine, or it has no access to USB.
    """
    backend = load_libusb()
    if backend is None and libusb1._lib is None:
        raise NotFound("libusb could not be loaded: install libusb-1.0 (apt install libusb-1.0-0, brew install libusb)")
    if backend is None:  # pyusb loaded it, but hides the reason of its failure
        raise _build_uninitialised_error("for a reason that pyusb does not report")
    try:
        return _Context(backend.lib)
    except usb.core.USBError as fault:
        raise _build_uninitialised_error(" ".join(str(fault).split())) from fault


def _build_uninitialised_error(reason: str) -> NotFound:
    """Build the error for a libusb that can be loaded but has no access to USB, for the given reason."""
    return NotFound(
        f"libusb failed to initialise ({reason}): is there USB on this machine, or in this container (--device /dev/bus/usb)?"
    )


def find_probe(serial: str | None, backends: Backends = open_libusb) -> FoundDevice:
    """Find the probe with the serial number, or the only one connected.

    Raises
    ------
    NotFound
        There is no such probe.
    Ambiguous
        Several probes match.
    AccessDenied
        A probe is connected that this user may not open.
    """
    probes = list_connected(backends())
    matching = [probe for probe in probes if probe.fault is None and serial in (None, probe.serial)]
    if len(matching) == 1:
        release([probe.device for probe in probes if probe is not matching[0]])
        return matching[0]
    release([probe.device for probe in probes])
    if matching:
        raise Ambiguous([probe.serial for probe in matching])
    raise _build_missing_error(serial, probes) from next((probe.fault for probe in probes if probe.fault), None)


def list_connected(backend: IBackend) -> list[FoundDevice]:
    """List all devices with the probe's numbers and interface, ordered by bus and address.

    Other boards may use the same test number (docs/reference/protocol.md); their interfaces have other classes.
    """
    devices = usb.core.find(find_all=True, idVendor=VENDOR_ID, idProduct=PRODUCT_ID, backend=backend, custom_match=_has_stream)
    return sorted((_read_serial(device) for device in devices), key=lambda probe: (probe.device.bus, probe.device.address))


def find_stream_endpoint(configuration: usb.core.Configuration) -> tuple[usb.core.Interface, usb.core.Endpoint] | None:
    """Find the vendor interface with a bulk IN endpoint; return its number and the endpoint, or None."""
    for interface in configuration:
        for endpoint in interface:
            bulk = usb.util.endpoint_type(endpoint.bmAttributes) == usb.util.ENDPOINT_TYPE_BULK
            if interface.bInterfaceClass == VENDOR_CLASS and bulk and endpoint.bEndpointAddress & usb.util.ENDPOINT_IN:
                return interface.bInterfaceNumber, endpoint
    return None


def _has_stream(device: usb.core.Device) -> bool:
    """Whether any configuration has the probe's interface; descriptors are readable without opening the device."""
    try:
        return any(find_stream_endpoint(configuration) is not None for configuration in device)
    except (usb.core.USBError, NotImplementedError):
        return True  # unknown: opening it will give the reason


def describe_address(device: usb.core.Device) -> str:
    """Describe bus and address as text."""
    return f"bus {device.bus} address {device.address}"


def release(devices: list[usb.core.Device]) -> None:
    """Release devices, including disconnected ones."""
    for device in devices:
        with suppress(usb.core.USBError, NotImplementedError):
            usb.util.dispose_resources(device)


def _read_serial(device: usb.core.Device) -> FoundDevice:
    """Read a device's serial number; unlike pyusb's property this keeps the reason of a failure."""
    try:
        # 0x80, 6: GET_DESCRIPTOR; its first byte is its length, its second its type
        descriptor = bytes(device.ctrl_transfer(0x80, 6, _STRING_DESCRIPTOR | device.iSerialNumber, _ENGLISH_US, 255))
    except (usb.core.USBError, NotImplementedError) as fault:
        return FoundDevice(device, "", fault)
    return FoundDevice(device, descriptor[2 : descriptor[0]].decode("utf-16-le", "replace") if descriptor else "")


def _build_missing_error(serial: str | None, probes: list[FoundDevice]) -> HardwareError:
    """Build the error for a missing probe: it is not connected, or its serial number could not be read."""
    for probe in probes:
        if probe.fault is not None:
            return translate_fault(probe.fault, f"a probe at {describe_address(probe.device)}")
    listing = f"; connected: {[probe.serial for probe in probes]}" if probes else ""
    wanted, numbers = f"probe {serial}" if serial else "a probe", f"{VENDOR_ID:04x}:{PRODUCT_ID:04x}"
    return NotFound(f"{wanted} (USB {numbers}) is not connected: plug it in, or use --virtual or --replay{listing}")
