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
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from geometry.common.errors import one_line
from hw.common.errors import RULES, udev_rule
from probe_design.doctor.finding import Finding

PACKAGES = ("probe-design", "numpy", "scipy", "pyusb", "libusb-package", "pyserial", "h5py", "pyvisa", "pyvisa-py")
RULE_FOLDERS = (
    "/etc/udev/rules.d",
    "/run/udev/rules.d",
    "/usr/local/lib/udev/rules.d",
    "/usr/lib/udev/rules.d",
    "/lib/udev/rules.d",
)
UDEV = Path("/run/udev")
SCOPE = "for oscilloscopes: pip install 'probe-design[scope]'"


class _Version(Structure):
    _fields_ = [(name, c_uint16) for name in ("major", "minor", "micro", "nano")] + [("rc", c_char_p), ("describe", c_char_p)]


def versions() -> dict[str, str | None]:
    """List the versions of Python, system and packages; None for packages that are not installed."""
    found: dict[str, str | None] = {"python": platform.python_version(), "system": platform.platform()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    return found


def installed() -> list[Finding]:
    """Run all checks of what reading needs, devices included."""
    looks: tuple[tuple[str, Callable[[], list[Finding]]], ...] = (
        ("libusb", _libusb), ("permissions", _udev), ("probes on USB", _probes), ("serial ports", _serial_ports),
        ("VISA", _visa), ("HDF5", _hdf5),
    )  # fmt: skip
    return [one for name, look in looks for one in _safely(name, look)]


def probes() -> list[Any]:
    """Find the probes on USB, including those that this user may not open. Raises libusb's exceptions."""
    from hw.usb.find import connected, libusb, release

    found = connected(libusb())
    release([one.device for one in found])
    return found


def _safely(name: str, look: Callable[[], list[Finding]]) -> list[Finding]:
    try:
        return look()
    except Exception as fault:  # any library on any machine: reported, and the next check runs
        return [Finding(name, "missing", f"{type(fault).__name__}: {one_line(str(fault))}", "")]


def _libusb() -> list[Finding]:
    remedy = "reinstall libusb-package, or install libusb-1.0 (apt install libusb-1.0-0, brew install libusb)"
    try:
        from hw.usb.find import libusb

        library = libusb().lib
        library.libusb_get_version.restype = POINTER(_Version)
        told = library.libusb_get_version().contents
    except Exception as fault:
        return [Finding("libusb", "missing", f"cannot be used ({one_line(str(fault)) or type(fault).__name__})", remedy)]
    return [Finding("libusb", "good", f"{told.major}.{told.minor}.{told.micro}.{told.nano}")]


def _udev() -> list[Finding]:
    if not sys.platform.startswith("linux"):
        return [
            Finding(
                "permissions", "good", "no rule is needed; on Windows the board brings its driver (docs/reference/protocol.md)"
            )
        ]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        return [Finding("permissions", "good", "this user is root, who may open every device")]
    folder = next((folder for folder in RULE_FOLDERS if (Path(folder) / RULES).is_file()), None)
    if folder is not None:
        return [Finding("permissions", "good", f"the udev rule is in {folder}")]
    remedy = (
        f"as root write to /etc/udev/rules.d/{RULES}: {udev_rule()} ; then udevadm control --reload, and plug the probe in again"
    )
    if not UDEV.is_dir():
        return [Finding("permissions", "missing", "udev does not run here (a container?)", f"where it runs, {remedy}")]
    return [Finding("permissions", "missing", "the udev rule for probes is not installed", remedy)]


def _probes() -> list[Finding]:
    from hw.usb.faults import named
    from hw.usb.find import where

    findings = []
    for one in probes():
        if one.fault is None:
            findings.append(Finding("probe on USB", "good", f"{one.serial} at {where(one.device)}"))
        else:
            text = f"a probe at {where(one.device)} that cannot be opened"
            findings.append(Finding("probe on USB", "fault", text, str(named(one.fault, "probe"))))
    return findings or [Finding("probes on USB", "missing", "none", "plug one in; or --virtual, --replay, another --device")]


def _serial_ports() -> list[Finding]:
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


def _visa() -> list[Finding]:
    try:
        visa = import_module("pyvisa")
        import_module("pyvisa_py")
        visa.ResourceManager("@py").close()
    except ImportError as missing:
        return [Finding("VISA", "missing", f"{missing.name or 'pyvisa'} is not installed", SCOPE)]
    except Exception as fault:
        return [Finding("VISA", "missing", f"cannot be used ({one_line(str(fault))})", SCOPE)]
    return [Finding("VISA", "good", "pyvisa with pyvisa-py; resources are not listed, which would broadcast on the network")]


def _hdf5() -> list[Finding]:
    try:
        library = import_module("h5py")
    except ImportError:
        return [Finding("HDF5", "missing", "h5py is not installed", "for .h5 files: pip install h5py")]
    return [Finding("HDF5", "good", f"{library.version.hdf5_version}")]
