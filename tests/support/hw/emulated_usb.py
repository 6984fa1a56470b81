"""Run a program of the tests among emulated USB devices; see ``usb_emulator.py``."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.support.paths import ROOT

PYTHON = "/usr/bin/python3"  # Debian's, which has the bindings of umockdev
NEEDS = "umockdev gir1.2-umockdev-1.0 python3-gi"
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}


def require_umockdev() -> None:
    """Skip a test where devices cannot be emulated; in the continuous integration that is a failure."""
    if reason := find_obstacle():
        (pytest.fail if os.environ.get("CI") == "true" else pytest.skip)(reason)


def find_obstacle() -> str:
    """What keeps the tests from running; empty if nothing does."""
    if not sys.platform.startswith("linux"):
        return "umockdev emulates Linux only"
    bindings = [PYTHON, "-c", "import gi; gi.require_version('UMockdev', '1.0'); from gi.repository import UMockdev"]
    if (
        shutil.which("umockdev-wrapper")
        and Path(PYTHON).exists()
        and subprocess.run(bindings, capture_output=True).returncode == 0
    ):
        return ""
    return f"no umockdev: apt-get install {NEEDS}"


def build_prefix(devices: Sequence[dict[str, Any]]) -> list[str]:
    """The words before a command that runs it among devices, with ``ENVIRONMENT``."""
    return ["umockdev-wrapper", PYTHON, str(ROOT / "tests" / "support" / "hw" / "usb_emulator.py"), json.dumps(devices)]
