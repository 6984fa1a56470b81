"""Check what this computer has for reading probes: versions, libusb, permissions, devices, serial ports, VISA.

The checks never raise: anything missing or broken is a finding with its remedy.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Callable
from ctypes import POINTER, Structure, c_char_p, c_uint16
from importlib import import_module
from pathlib import Path
from typing import Any

from geometry.common.errors import to_one_line
from geometry.provenance.block import DISTRIBUTION, find_version
from hw.common.errors import UDEV_RULES_FILE, read_udev_rule
from probe_design.doctor.finding import Finding

PACKAGE_NAMES = (DISTRIBUTION, "numpy", "scipy", "pyusb", "libusb-package", "pyserial", "h5py", "pyvisa", "pyvisa-py")
RULE_FOLDERS = (
    "/etc/udev/rules.d",
    "/run/udev/rules.d",
    "/usr/local/lib/udev/rules.d",
    "/usr/lib/udev/rules.d",
    "/lib/udev/rules.d",
)
UDEV_FOLDER = Path("/run/udev")
SCOPE_REMEDY = "for oscilloscopes: pip install '.[scope]'"


class _Version(Structure):
    """The structure ``libusb_version`` of libusb's C interface."""

    _fields_ = [(name, c_uint16) for name in ("major", "minor", "micro", "nano")] + [("rc", c_char_p), ("describe", c_char_p)]


def list_versions() -> dict[str, str | None]:
    """List the versions of Python, system and packages; None for packages that are not installed."""
    installed_versions: dict[str, str | None] = {"python": platform.python_version(), "system": platform.platform()}
    return installed_versions | {name: find_version(name) for name in PACKAGE_NAMES}


def check_installation() -> list[Finding]:
    """Run all checks of what reading needs, devices included."""
    checks: tuple[tuple[str, Callable[[], list[Finding]]], ...] = (
        ("libusb", _check_libusb), ("permissions", _check_permissions), ("probes on USB", _check_probes),
        ("serial ports", _check_serial_ports),
        ("VISA", _check_visa), ("HDF5", _check_hdf5),
    )  # fmt: skip
    return [finding for name, check in checks for finding in _run_safely(name, check)]


def find_usb_probes() -> list[Any]:
    """Find the probes on USB, including those that this user may not open. Raises libusb's exceptions."""
    from hw.usb.find import list_connected, open_libusb, release

    devices = list_connected(open_libusb())
    release([device.device for device in devices])
    return devices


def _run_safely(name: str, check: Callable[[], list[Finding]]) -> list[Finding]:
    """Run a check; an exception becomes a finding under ``name``."""
    try:
        return check()
    except Exception as fault:  # any library on any machine: reported, and the next check runs
        return [Finding(name, "missing", f"{type(fault).__name__}: {to_one_line(str(fault))}", "")]


def _check_libusb() -> list[Finding]:
    """Check that libusb can be loaded and used."""
    remedy = "reinstall libusb-package, or install libusb-1.0 (apt install libusb-1.0-0, brew install libusb)"
    try:
        from hw.usb.find import open_libusb

        library = open_libusb().lib
        library.libusb_get_version.restype = POINTER(_Version)
        numbers = library.libusb_get_version().contents
    except Exception as fault:
        return [Finding("libusb", "missing", f"cannot be used ({to_one_line(str(fault)) or type(fault).__name__})", remedy)]
    return [Finding("libusb", "good", f"{numbers.major}.{numbers.minor}.{numbers.micro}.{numbers.nano}")]


def _check_permissions() -> list[Finding]:
    """Check that this user may open a probe on USB; where not, give the udev rule as the remedy."""
    if not sys.platform.startswith("linux"):
        return [
            Finding(
                "permissions", "good", "no rule is needed; on Windows the board brings its driver (docs/reference/protocol.md)"
            )
        ]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        return [Finding("permissions", "good", "this user is root, who may open every device")]
    folder = next((folder for folder in RULE_FOLDERS if (Path(folder) / UDEV_RULES_FILE).is_file()), None)
    if folder is not None:
        return [Finding("permissions", "good", f"the udev rule is in {folder}")]
    remedy = (
        f"as root write to /etc/udev/rules.d/{UDEV_RULES_FILE}: {read_udev_rule()} ; then udevadm control "
        "--reload, and plug the probe in again"
    )
    if not UDEV_FOLDER.is_dir():
        return [Finding("permissions", "missing", "udev does not run here (a container?)", f"where it runs, {remedy}")]
    return [Finding("permissions", "missing", "the udev rule for probes is not installed", remedy)]


def _check_probes() -> list[Finding]:
    """List the probes on USB, those too that cannot be opened."""
    from hw.usb.faults import translate_fault
    from hw.usb.find import describe_address

    findings = []
    for probe in find_usb_probes():
        if probe.fault is None:
            findings.append(Finding("probe on USB", "good", f"{probe.serial} at {describe_address(probe.device)}"))
        else:
            text = f"a probe at {describe_address(probe.device)} that cannot be opened"
            findings.append(Finding("probe on USB", "fault", text, str(translate_fault(probe.fault, "probe"))))
    return findings or [Finding("probes on USB", "missing", "none", "plug one in; or --virtual, --replay, another --device")]


def _check_serial_ports() -> list[Finding]:
    """List the serial ports, and check that this user may open them."""
    try:
        ports = import_module("serial.tools.list_ports").comports()
    except ImportError:
        return [Finding("serial ports", "missing", "pyserial is not installed", "for boards on them: pip install pyserial")]
    findings = []
    for port in ports:
        text = f"{port.device}: {port.description}"
        if os.path.exists(port.device) and not os.access(port.device, os.R_OK | os.W_OK):
            remedy = "join the port's group (sudo usermod -aG dialout $USER), log out and in again"
            findings.append(Finding("serial port", "doubtful", f"{text}; this user may not open it", remedy))
        else:
            findings.append(Finding("serial port", "good", text))
    return findings or [Finding("serial ports", "missing", "none")]


def _check_visa() -> list[Finding]:
    """Check that pyvisa with pyvisa-py can be used for oscilloscopes."""
    try:
        visa = import_module("pyvisa")
        import_module("pyvisa_py")
        visa.ResourceManager("@py").close()
    except ImportError as missing:
        return [Finding("VISA", "missing", f"{missing.name or 'pyvisa'} is not installed", SCOPE_REMEDY)]
    except Exception as fault:
        return [Finding("VISA", "missing", f"cannot be used ({to_one_line(str(fault))})", SCOPE_REMEDY)]
    return [Finding("VISA", "good", "pyvisa with pyvisa-py; resources are not listed, which would broadcast on the network")]


def _check_hdf5() -> list[Finding]:
    """Check that h5py can be loaded."""
    try:
        library = import_module("h5py")
    except ImportError:
        return [Finding("HDF5", "missing", "h5py is not installed", "for .h5 files: pip install h5py")]
    return [Finding("HDF5", "good", f"{library.version.hdf5_version}")]
