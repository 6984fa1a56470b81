"""What goes wrong is named, in one line that states what to do."""

from __future__ import annotations

import errno
import sys
from types import SimpleNamespace

import pytest
from usb.core import NoBackendError, USBError, USBTimeoutError

from hw.common.errors import (
    AccessDenied,
    Busy,
    Disconnected,
    HardwareError,
    InvalidSource,
    NotFound,
    ProtocolError,
    Stalled,
    Timeout,
    TransferError,
)
from hw.reader import Reader
from hw.simulation import virtual as virtual_bus
from hw.simulation.firmware import Halted
from hw.usb import find
from hw.usb.device import UsbDevice
from hw.usb.faults import classify_fault
from hw.wire.protocol import START
from hw.wire.stream import StreamTransport
from tests.support.hw.faulty_probe import Fault, Kind
from tests.support.hw.virtual_probes import probe, read
from tests.support.paths import ROOT


@pytest.mark.parametrize(
    ("kind", "error", "remedy"),
    [
        ("stall", Stalled, "unplug it and plug it in again"), ("error", TransferError, "try another cable or port"),
        ("unplug", Disconnected, "check plug and cable"), ("silence", Timeout, "it is connected but does not respond"),
    ],
)  # fmt: skip
def test_lasting_fault_is_named(kind: Kind, error: type[HardwareError], remedy: str) -> None:
    with pytest.raises(error, match=remedy) as caught:
        read(probe(Fault(kind, 70, 1000, 1.0)))
    assert isinstance(caught.value.__cause__, USBError)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 1


@pytest.mark.parametrize("source", ["", "usbs", "visa:", "replay", "virtual:x"])
def test_unknown_sources(source: str) -> None:
    with pytest.raises(InvalidSource, match="allowed: usb, usb:SERIAL, serial:PORT, visa:RESOURCE, replay:FILE") as caught:
        Reader.open(source)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), 1e9])
def test_impossible_rates(rate: float) -> None:
    with pytest.raises(InvalidSource, match=r"rate = .* allowed: 0.001 to 4000000 Hz"):
        Reader.open(probe(), rate)


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan"), float("inf"), 1e-9])
def test_impossible_durations(seconds: float) -> None:
    with Reader.open(probe()) as reader, pytest.raises(InvalidSource, match="allowed: a sample, 1e-05 s, or more"):
        reader.collect(seconds)


def test_probe_that_a_dead_program_left_running() -> None:
    source = probe()
    source.firmware.control(START, 9, b"")
    with Reader.open(source, rate=50_000.0) as reader:
        assert reader.header.rate == 50_000.0
        assert reader.collect(0.01).index[0] == 0


def test_board_that_knows_no_requests(monkeypatch: pytest.MonkeyPatch) -> None:
    source = probe()

    def refuses(request: int, value: int, data: bytes) -> bytes:
        raise Halted

    monkeypatch.setattr(source.firmware, "control", refuses)
    with pytest.raises(ProtocolError, match=r"probe V1 refuses the requests of docs/reference/protocol.md"):
        Reader.open(source)


def test_other_serial_is_not_found() -> None:
    with pytest.raises(NotFound, match=r"probe V2 .* is not connected: .*V1"):
        StreamTransport(UsbDevice("V2", probe()))


@pytest.mark.parametrize(
    ("fault", "kind"),
    [
        (USBTimeoutError("", None, 60), Timeout), (USBError("", -7, 60), Timeout), (USBError("", -9, None), Stalled),
        (USBError("", -4, 6), Disconnected), (USBError("", None, errno.ENODEV), Disconnected),
        (USBError("", -3, 13), AccessDenied), (USBError("", -6, 16), Busy), (USBError("", -1, 5), TransferError),
        (USBError("", -99, None), TransferError), (NotImplementedError(), AccessDenied), (NoBackendError(""), NotFound),
        (ProtocolError(""), TransferError),
    ],
)  # fmt: skip
def test_meaning_of_faults_by_class_and_code(fault: Exception, kind: type[HardwareError]) -> None:
    """libusb's codes (libusb.h) decide, whatever a system's errno is: 60 is ETIMEDOUT on macOS, ENOSTR on Linux."""
    assert classify_fault(fault) is kind


def test_access_denied_prints_the_shipped_rule() -> None:
    rule = 'SUBSYSTEM=="usb", ATTR{idVendor}=="1209", ATTR{idProduct}=="0001", MODE="0660", GROUP="plugdev", TAG+="uaccess"'
    shipped = (ROOT / "hw" / "60-probe-design.rules").read_text(encoding="utf-8")
    assert rule in shipped.splitlines()
    assert rule in str(AccessDenied("probe V1"))


def test_another_board_of_the_same_test_number_is_no_probe(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the numbers were looked at: a keyboard under development was opened, or made the choice ambiguous."""
    monkeypatch.setitem(virtual_bus._INTERFACE_DESCRIPTOR, "bInterfaceClass", 3)
    with pytest.raises(NotFound, match="is not connected"):
        Reader.open(probe())


@pytest.mark.parametrize("pyusb_tells", [True, False])
def test_libusb_that_does_not_begin_is_said_as_such(monkeypatch: pytest.MonkeyPatch, pyusb_tells: bool) -> None:
    """It was a bus that failed, again and again: try another cable."""

    def fails(library: object) -> None:
        raise USBError("Other error", -99, None)

    monkeypatch.setattr(find, "_Context", fails)
    monkeypatch.setattr(find.libusb1, "_lib", object())
    backend = SimpleNamespace(lib=None) if pyusb_tells else None
    monkeypatch.setattr(find, "load_libusb", lambda: backend)
    with pytest.raises(NotFound, match=r"libusb failed to initialise .* is there USB on this machine"):
        Reader.open("usb")


def test_headless_machines_have_a_group() -> None:
    assert 'GROUP="plugdev"' in str(AccessDenied("probe V1"))


def test_without_libusb_package_the_system_s_libusb_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "libusb_package", None)
    monkeypatch.setattr(find.libusb1, "get_backend", lambda: "of the system")
    assert find.load_libusb() == "of the system"
