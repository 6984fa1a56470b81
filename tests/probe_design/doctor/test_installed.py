"""What the computer has: whatever is missing or broken is a finding with its remedy, never a traceback."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from hw.common.errors import NotFound
from hw.usb.find import FoundDevice
from probe_design.doctor import installed
from probe_design.doctor.finding import Finding
from tests.support import program
from tests.support.paths import SCENE


def test_without_libusb_visa_serial_and_hdf5(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("pyvisa", "pyvisa_py", "serial", "serial.tools", "serial.tools.list_ports", "h5py"):
        monkeypatch.setitem(sys.modules, name, None)  # an import of it fails
    monkeypatch.setattr("libusb_package.get_libusb1_backend", lambda: None)
    ended = program.run("doctor", "--json")
    assert (ended.returncode, ended.stderr) == (0, "")
    by_name = {entry["name"]: entry for entry in json.loads(ended.stdout)["installed"]}
    for name, remedy in (("libusb", "libusb-1.0"), ("VISA", ".[scope]"), ("HDF5", "pip install h5py")):
        assert by_name[name]["state"] == "missing"
        assert remedy in by_name[name]["remedy"]
    assert by_name["serial ports"]["state"] == "missing"


def denied(name: str, fault: Exception | None) -> list[FoundDevice]:
    return [FoundDevice(SimpleNamespace(bus=1, address=7), name, fault)]


def test_a_probe_that_may_not_be_opened_is_a_fault_with_the_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    from usb.core import USBError

    monkeypatch.setattr(installed, "find_usb_probes", lambda: denied("", USBError("Access denied", -3, 13)))
    (finding,) = installed._check_probes()
    assert (finding.state, "udev" in finding.remedy, "SUBSYSTEM" in finding.remedy) == ("fault", True, True)
    monkeypatch.setattr(installed, "find_usb_probes", lambda: denied("AB1", None))
    assert installed._check_probes() == [Finding("probe on USB", "good", "AB1 at bus 1 address 7")]


def test_what_raises_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> list[FoundDevice]:
        raise NotFound("libusb could not\nbe loaded")

    monkeypatch.setattr(installed, "find_usb_probes", broken)
    by_name = {finding.name: finding for finding in installed.check_installation()}
    assert by_name["probes on USB"].text == "NotFound: libusb could not be loaded"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="udev is Linux's")
def test_the_rule_is_looked_for(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(installed.os, "geteuid", lambda: 1000)
    monkeypatch.setattr(installed, "RULE_FOLDERS", (str(tmp_path),))
    monkeypatch.setattr(installed, "UDEV_FOLDER", tmp_path)
    (finding,) = installed._check_permissions()
    assert (finding.state, "1209" in finding.remedy) == ("missing", True)
    monkeypatch.setattr(installed, "UDEV_FOLDER", tmp_path / "absent")
    assert "does not run here" in installed._check_permissions()[0].text
    (tmp_path / installed.UDEV_RULES_FILE).write_text("")
    assert installed._check_permissions()[0].state == "good"


def test_the_verb_tests_a_virtual_probe() -> None:
    ended = program.run("doctor", SCENE, "--virtual", "--seconds", "5", "--json")
    assert ended.returncode == 0, ended.stderr
    output = json.loads(ended.stdout)
    assert output["good"]
    assert {entry["state"] for entry in output["self_test"]} == {"good"}
    assert {"noise, inner", "polarity, outer", "load, force", "clipping", "mains"} <= {
        entry["name"] for entry in output["self_test"]
    }
    assert output["versions"]["pyusb"]


def test_a_table_and_exit_code_1_for_a_fault(tmp_path: Path) -> None:
    rows = "\n".join(f"{k / 1000},{0.001 * (k % 2)},{0.0}" for k in range(1000))
    (tmp_path / "a.csv").write_text("time (s),inner (V),outer (V)\n" + rows)
    ended = program.run("doctor", SCENE, "--replay", "a.csv", cwd=tmp_path)
    assert ended.returncode == 1
    assert "at fault: outer channel" in ended.stdout
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize(
    ("words", "code", "expected"),
    [
        (("--replay", "absent.probe"), 2, "no such file"),
        (("--device", "usb:NONE"), 1, ""),
        (("--virtual", "--device", "usb"), 2, "one of --virtual"),
        (("--device", "nonsense"), 2, "allowed"),
    ],
)
def test_bad_words(words: tuple[str, ...], code: int, expected: str) -> None:
    ended = program.run("doctor", SCENE, *words)
    assert ended.returncode == code
    assert expected in ended.stderr
