"""The bench page in a real Chromium: a scan of a virtual tissue until the map shows the hidden tumour, and a killed worker."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hw.files.columns import ColumnMap
from probe_design.commands.hardware_sources import HardwareSetup
from probe_design.commands.scan_recordings import read_scan_recordings
from probe_design.populations.design_file import read_design
from tests.support.explorer import PATIENCE_MS, kill_worker, open_browser, serve_pages
from tests.support.paths import ROOT

DESIGN = ROOT / "examples" / "scans" / "one-clear.toml"
TUMOUR_MM = (3.0, -5.0)  # of examples/scans/hidden.toml
PRESSES = 9


@pytest.mark.slow
def test_scan_of_a_hidden_tumour(tmp_path: Path) -> None:
    words = (str(DESIGN), "--hide", str(DESIGN.with_name("hidden.toml")), "-o", str(tmp_path / "scan"))
    with serve_pages(*words) as (address, server), open_browser() as browser:
        page = browser.new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.goto(address)
        page.get_by_role("link", name="Bench").click()
        page.locator("img.plan").wait_for()
        start = float(page.locator("[data-bench=none]").get_attribute("data-value") or "nan")
        page.get_by_label("seconds").fill("2,0")
        for number in range(1, PRESSES + 1):
            if number == 4:  # the worker is killed between two presses, and in the next: the folder holds what it knew
                kill_worker(server)
                frames = page.locator("canvas").get_attribute("data-frames")
                page.get_by_role("button", name="Record").click()
                page.wait_for_function(f"() => document.querySelector('canvas').dataset.frames > {frames}")
                kill_worker(server)
                page.get_by_text("the worker ended: its process was ended by SIGKILL").wait_for()
            page.get_by_role("button", name="Record").click()
            page.locator(f"[data-reading='{number}']").wait_for()
        assert float(page.locator("[data-bench=none]").get_attribute("data-value") or "nan") < 0.01 < start
        x, y = json.loads(page.locator("[data-bench=next]").get_attribute("data-value") or "[]")
        assert np.hypot(1e3 * x - TUMOUR_MM[0], 1e3 * y - TUMOUR_MM[1]) < 12  # it goes on pressing around the tumour
        assert int(page.locator("canvas").get_attribute("data-frames") or 0) > 10 * PRESSES
        shown = [
            float(page.locator(f"[data-reading='{number}']").get_attribute("data-value") or "nan")
            for number in range(1, PRESSES + 1)
        ]
    design = read_design(DESIGN)
    names = [f"press-{number:03d}{'-again2' if number == 4 else ''}.probe" for number in range(1, PRESSES + 1)]
    assert {path.name for path in (tmp_path / "scan").glob("*.probe")} == {*names, "press-004.probe"}  # the interrupted one stays
    files = tuple(str(tmp_path / "scan" / name) for name in names)
    readings, _ = read_scan_recordings(
        HardwareSetup.from_scene(design.scene, None, None), design, files, columns=ColumnMap(), rate=None, any_probe=False
    )
    assert shown == pytest.approx([reading.ratio for reading in readings], rel=1e-9)
    assert [reading.blank for reading in readings] == [True] + [False] * (PRESSES - 1)
