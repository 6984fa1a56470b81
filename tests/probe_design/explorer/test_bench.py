"""The bench page in a real Chromium: a virtual scan with a killed worker, a board on a serial port, recordings with faults."""

from __future__ import annotations

import json
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hw.files.columns import ColumnMap
from probe_design import Locator
from probe_design.commands.hardware_sources import HardwareSetup
from probe_design.commands.scan_recordings import read_scan_recordings
from probe_design.locating.run import run_locate
from probe_design.populations.design_file import read_design
from tests.support.explorer import PATIENCE_MS, kill_worker, open_browser, serve_pages
from tests.support.hw.emulated_usb import build_prefix, require_umockdev
from tests.support.hw.firmware_board import posix_board
from tests.support.paths import EXAMPLES, ROOT

DESIGN = ROOT / "examples" / "scans" / "one-clear.toml"
TUMOUR_MM = (3.0, -5.0)  # of examples/scans/hidden.toml
PRESSES = 9


def open_bench(browser: Any, address: str) -> Any:
    """Open the bench page, ready for its first reading."""
    page = browser.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.goto(address)
    page.get_by_role("link", name="Bench").click()
    page.get_by_text("ready; 0 readings").wait_for()
    return page


@pytest.mark.slow
def test_scan_of_a_hidden_tumour(tmp_path: Path) -> None:
    words = (str(DESIGN), "--hide", str(DESIGN.with_name("hidden.toml")), "-o", str(tmp_path / "scan"))
    with serve_pages(*words) as (address, server), open_browser() as browser:
        page = open_bench(browser, address)
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
            if number == 2:  # pressed again, as if the probe had slipped
                page.get_by_role("button", name="Discard").click()
                page.get_by_text("ready; 1 readings").wait_for()
                page.get_by_role("button", name="Record").click()
                page.locator("[data-reading='2']").wait_for()
        assert float(page.locator("[data-bench=none]").get_attribute("data-value") or "nan") < 0.01 < start
        following = json.loads(page.locator("[data-bench=next]").get_attribute("data-value") or "[]")
        assert int(page.locator("canvas").get_attribute("data-frames") or 0) > 10 * PRESSES
        shown = [
            float(page.locator(f"[data-reading='{number}']").get_attribute("data-value") or "nan")
            for number in range(1, PRESSES + 1)
        ]
    design = read_design(DESIGN)
    names = [f"press-{number:03d}{'-again2' if number in (2, 4) else ''}.probe" for number in range(1, PRESSES + 1)]
    kept = {path.name for path in (tmp_path / "scan").glob("*.probe")}
    assert kept == {*names, "press-002.probe", "press-004.probe"}  # the discarded and the interrupted one stay
    files = tuple(str(tmp_path / "scan" / name) for name in names)
    readings, _ = read_scan_recordings(
        HardwareSetup.from_scene(design.scene, None, None), design, files, columns=ColumnMap(), rate=None, any_probe=False
    )
    assert shown == pytest.approx([reading.ratio for reading in readings], rel=1e-9)
    assert [reading.blank for reading in readings] == [True] + [False] * (PRESSES - 1)
    locator = Locator(design)
    for reading in readings:
        locator.update(reading)
    advised = locator.next_position()
    assert following == pytest.approx([advised.x, advised.y], abs=1e-9)  # of the recordings, in one process that nobody killed
    tumour = run_locate(design, tuple(readings), 0.0, 0, advise=False).tumours[0]
    for name, truth in zip("xy", TUMOUR_MM, strict=True):
        low, high = tumour.quantities[name].interval_90
        assert low < 1e-3 * truth < high
        assert high - low < 4e-3


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
@pytest.mark.parametrize("kind", ["serial", "usb"])
def test_a_board(kind: str, tmp_path: Path) -> None:
    """A firmware on a serial port, and an emulated one on USB, give 27/40 of the outer film's code to the inner film."""
    if kind == "usb":
        require_umockdev()
    with posix_board("-c", "3") if kind == "serial" else nullcontext() as port:
        device = "usb:A1" if port is None else f"serial:{port}"
        prefix = [] if kind == "serial" else build_prefix([{"serial": "A1", "load": True, "pace": True}])
        words = (str(EXAMPLES / "scene.toml"), "--device", device, "-o", str(tmp_path / "out"))
        with serve_pages(*words, prefix=prefix) as (address, _), open_browser() as browser:
            page = open_bench(browser, address)
            page.get_by_label("seconds").fill("2")
            page.get_by_role("button", name="Record").click()
            page.locator("[data-reading='1']").wait_for()
            inner, outer = (
                float(page.locator(f"[data-bench='charge {name}']").get_attribute("data-value") or "nan")
                for name in ("inner", "outer")
            )
    assert inner / outer == pytest.approx(27 / 40, rel=1e-3)
    assert (tmp_path / "out" / "press-001.probe").stat().st_size > 1000


@pytest.mark.slow
def test_faults_of_recordings_are_said(tmp_path: Path) -> None:
    """Mains hum 17 times the load's signal is a warning; a channel cut off at 2.5 V is refused, and shows no older numbers."""
    t = np.arange(8000) / 2000
    load, hum = np.sin(2 * np.pi * 5 * t), 2e-3 * np.sin(2 * np.pi * 50.02 * t)
    recordings = {
        "hum": [8e-5 * load + hum, 12e-5 * load + hum],
        "cut": [np.clip(size * load, -2.5, 2.5) for size in (3, 4)],
    }
    words = [word for name in ("time=time s", "inner=inner V", "outer=outer V") for word in ("--column", name)]
    for name, films in recordings.items():
        path = tmp_path / f"{name}.csv"
        np.savetxt(path, np.column_stack([t, *films]), delimiter=",", header="time,inner,outer", comments="")
        words += ["--replay", str(path)]
    with serve_pages(str(EXAMPLES / "scene.toml"), *words) as (address, _), open_browser() as browser:
        page = open_bench(browser, address)
        page.get_by_role("button", name="Watch").click()
        page.get_by_text("mains hum is 17 times the signal").wait_for()
        page.get_by_label("source").click()
        page.get_by_role("option", name="cut.csv").click()
        page.get_by_role("button", name="Watch").click()
        page.get_by_text("is it cut off or overloaded?").wait_for()
        assert page.locator("[data-bench=ratio]").count() == 0
