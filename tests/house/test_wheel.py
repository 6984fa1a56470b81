"""What the wheel holds, and what installs from it therefore find."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from zipfile import ZipFile

from tests.support.paths import ROOT

PACKAGES = ("geometry", "hw", "probe_design", "solver")


def test_wheel_holds_every_source_and_all_data(tmp_path: Path) -> None:
    """Slow without hatchling beside: pip then fetches it, 15 s."""
    beside = ["--no-build-isolation"] if find_spec("hatchling") else []
    words = ["-m", "pip", "--disable-pip-version-check", "wheel", "--quiet", "--no-deps", *beside, "--wheel-dir", str(tmp_path)]
    ended = subprocess.run([sys.executable, *words, str(ROOT)], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    (wheel,) = tmp_path.glob("*.whl")
    held = {name for name in ZipFile(wheel).namelist() if ".dist-info/" not in name}
    files = (path for package in PACKAGES for path in (ROOT / package).rglob("*.*") if path.is_file())
    assert held == {path.relative_to(ROOT).as_posix() for path in files if path.suffix != ".pyc"}
    assert {Path(name).suffix for name in held} >= {".py", ".json", ".npy", ".toml", ".in", ".rules"}
