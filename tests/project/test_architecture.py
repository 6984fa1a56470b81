"""The architecture page is what its script prints, and shows every package."""

from __future__ import annotations

import subprocess
import sys

from tests.support.paths import ROOT

SCRIPT = ROOT / "docs" / "make_architecture.py"


def test_page_is_what_its_script_prints() -> None:
    command = f"import runpy; print(runpy.run_path({str(SCRIPT)!r})['page'](), end='')"
    printed = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True).stdout
    written = (ROOT / "docs" / "explanation" / "architecture.md").read_text(encoding="utf-8")
    assert printed == written, "run python docs/make_architecture.py"
