"""The real libusb, on emulated devices.

tests/support/hw/usb_emulator.py is the kernel and the boards, tests/support/hw/usb_reading.py the program under test.
"""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import pytest

from tests.support.hw.emulated_usb import ENVIRONMENT, build_prefix, require_umockdev
from tests.support.paths import ROOT
from tests.support.slow import slow_unless

ROWS = {64: 10, 511: 121, 512: 122, 513: 122, 1024: 250}  # of two channels in a frame: (size - 24) // 4


@pytest.fixture(scope="module", autouse=True)
def umockdev() -> None:
    require_umockdev()


RESOURCE = "USB0::0x1AB1::0x04CE::DS1::INSTR"


def reading(*devices: dict[str, Any], serial: str = "", seconds: float = 0.1) -> dict[str, Any]:
    """What the program reports that reads for a while among the devices."""
    command = [*build_prefix(devices), sys.executable, "-W", "error"]
    command += [str(ROOT / "tests" / "support" / "hw" / "usb_reading.py"), serial, str(seconds)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120, env=ENVIRONMENT)
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr == ""
    output: dict[str, Any] = json.loads(ended.stdout)
    return output


def gaps(output: dict[str, Any]) -> list[tuple[int, int, str]]:
    """The gaps, where every sample that did arrive was right and in its place."""
    assert "error" not in output, output
    assert output["wrong"] == 0
    assert output["steps"] == len(output["gaps"])
    assert output["rows"] + sum(abs(gap["count"]) for gap in output["gaps"]) == output["last"] + 1
    return [(gap["first"], gap["count"], gap["reason"]) for gap in output["gaps"]]


@pytest.mark.parametrize("packet", slow_unless((512).__eq__, ROWS))
def test_packet_sizes(packet: int) -> None:
    output = reading({"serial": "A1", "packet": packet}, seconds=0.3)
    assert gaps(output) == []
    assert output["rows"] == 30_000
    assert output["source"]["serial"] == "A1"
    assert (output["source"]["transport"], output["source"]["firmware"]) == ("usb", "emulated 1")


@pytest.mark.slow
def test_million_samples_without_one_lost_or_invented() -> None:
    output = reading({"serial": "A1", "sequence": 2**32 - 100}, seconds=10)  # the sequence wraps on the way
    assert gaps(output) == []
    assert output["rows"] == 1_000_000


def test_two_identical_devices() -> None:
    pair = {"serial": "A1"}, {"serial": "B2"}
    output = reading(*pair)
    assert output["error"] == "Ambiguous"
    assert "usb:A1" in output["message"]
    assert reading(*pair, serial="B2")["source"]["serial"] == "B2"


def test_two_devices_of_one_serial_number() -> None:
    output = reading({"serial": "A1"}, {"serial": "A1"}, serial="A1")
    assert (output["error"], output["message"]) == ("Ambiguous", "2 probes have the serial number A1: unplug all but one")


def test_the_one_that_may_be_opened_is_taken() -> None:
    assert reading({"serial": "A1", "denied": True}, {"serial": "B2"})["source"]["serial"] == "B2"
    assert reading({"serial": "A1", "denied": True}, {"serial": "B2", "denied": True})["error"] == "AccessDenied"


@pytest.mark.parametrize(
    ("devices", "error", "remedy"),
    [
        ([], "NotFound", "plug it in"), ([{"serial": "B2"}], "NotFound", "connected: ['B2']"),
        ([{"serial": "A1", "busy": True}], "Busy", "close that program"),
        ([{"serial": "A1", "denied": True}], "AccessDenied", 'TAG+="uaccess"'),
    ],
)  # fmt: skip
def test_device_that_cannot_be_had(devices: list[dict[str, Any]], error: str, remedy: str) -> None:
    output = reading(*devices, serial="A1")
    assert output["error"] == error
    assert remedy in output["message"]
    assert output["cause"] == ("NoneType" if error == "NotFound" else "USBError")


def faulty(kind: str, count: int = 1, **options: Any) -> dict[str, Any]:
    return reading({"serial": "A1", "faults": [[30, kind, count]], **options})


FIRST = 30 * ROWS[512]


@pytest.mark.parametrize(
    ("kind", "count", "lost", "reason"),
    slow_unless(lambda case: case[0] in ("drop", "unplug"), [
        ("drop", 2, 2, "frames were lost or damaged on the way"), ("stall", 1, 1, "the endpoint was halted"),
        ("stall", 3, 3, "the endpoint was halted"), ("error", 1, 1, "the bus failed"), ("error", 3, 3, "the bus failed"),
        ("unplug", 1, 5, "the device was unplugged, and came back at bus 1 address 12"),
    ]),
)  # fmt: skip
def test_fault_becomes_a_gap(kind: str, count: int, lost: int, reason: str) -> None:
    """What came in the same transfer before the fault is not lost: the gap begins at the fault's frame."""
    assert gaps(faulty(kind, count)) == [(FIRST, lost * ROWS[512], reason)]


@pytest.mark.parametrize("kind", slow_unless("partial".__eq__, ["partial", "timeout"]))
def test_time_out_loses_nothing(kind: str) -> None:
    output = faulty(kind)
    assert gaps(output) == []
    assert output["rows"] == 10_000


def test_device_that_lost_its_power_is_not_spliced() -> None:
    assert gaps(faulty("power")) == [(FIRST, -1, "the device was unplugged, and came back at bus 1 address 12")]


@pytest.mark.slow
def test_unplugged_again_and_again_beside_another_device() -> None:
    faults = [[30, "unplug", 1], [100, "unplug", 1], [200, "power", 1]]
    output = reading({"serial": "A1", "faults": faults}, {"serial": "B2"}, serial="A1", seconds=0.5)
    assert [(count, reason.rsplit(" ", 1)[1]) for _, count, reason in gaps(output)] == [(610, "12"), (610, "22"), (-1, "32")]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "error", "cause"),
    [("stall", "Stalled", "USBError"), ("error", "TransferError", "USBError"), ("timeout", "Timeout", "USBTimeoutError")],
)
def test_lasting_fault_is_named(kind: str, error: str, cause: str) -> None:
    output = faulty(kind, 50)
    assert (output["error"], output["cause"]) == (error, cause)


def test_device_that_does_not_come_back() -> None:
    output = faulty("unplug", returns=False)
    assert (output["error"], output["cause"]) == ("Disconnected", "USBError")
    assert "did not come back" in output["message"]


@pytest.mark.parametrize(
    ("acquisitions", "third"), slow_unless(lambda case: case[0] == 2, [(2, "Disconnected from USBError"), (3, "came")])
)
def test_oscilloscope_by_pyvisa_over_usbtmc(acquisitions: int, third: str) -> None:
    output = reading({"serial": "DS1", "acquisitions": acquisitions, "returns": False}, serial=RESOURCE)
    assert (output["wrong"], output["third"]) == (0, third)
    assert output["source"]["model"] == "RIGOL TECHNOLOGIES DS1104Z"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("state", "error"), [({"busy": True}, "Busy"), ({"denied": True}, "NotFound"), ({"serial": "DS2"}, "NotFound")]
)
def test_oscilloscope_that_cannot_be_had(state: dict[str, Any], error: str) -> None:
    output = reading({"serial": "DS1", "acquisitions": 1} | state, serial=RESOURCE)
    assert output["error"] == error
    assert RESOURCE in output["message"]
