"""From an event of a slider to the redrawn page, and memory of the server, in headless Chromium.

    python -m benchmarks.explorer.latency [EVENTS]

Each event is a key on a random slider of examples/scene.toml. Times are from the key to the frame after the new ratio, and to the
frame after the new map of detection.

Duration: 4 minutes.
"""

from __future__ import annotations

import os
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from playwright.sync_api import Page, sync_playwright

WATCH = """() => {
  window.start = 0; window.times = {};
  addEventListener("keydown", () => { window.start = performance.now(); window.times = {}; }, true);
  const watch = (name, selector) => new MutationObserver(() => requestAnimationFrame(() => {
    window.times[name] ??= performance.now() - window.start; })).observe(document.querySelector(selector).parentElement,
    { childList: true, subtree: true, characterData: true });
  watch("outputs", "table.outputs"); watch("map", "[data-drawings]"); }"""
PAUSE_MS = 60_000  # until an event counts as lost
SEED = 41


def main() -> None:
    events = int(sys.argv[1]) if len(sys.argv) > 1 else 300
    command = [sys.executable, "-m", "probe_design", "explore", "examples/scene.toml", "--no-browser"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        start = time.perf_counter()
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
            try:
                times, growth, processor = _measure(server, browser.new_page(), start, events)
            finally:
                server.terminate()
        browser.close()
    print("| redrawn | median, ms | 95th percentile, ms |\n|---|---|---|")
    for name, values in times.items():
        print(f"| {name} | {np.median(values):.0f} | {np.percentile(values, 95):.0f} |")
    print(f"{events} events: memory of the server grew by {growth:.1f} MB; it took {processor:.0f} ms of a processor for each")
    print(f"load average {os.getloadavg()[1]:.1f} on {os.cpu_count()} processors")


def _measure(server: subprocess.Popen[str], page: Page, start: float, events: int) -> tuple[dict[str, list[float]], float, float]:
    """Return times by what is redrawn, ms, the growth of the server's memory, MB, and its processor time for an event, ms."""
    assert server.stdout is not None
    page.goto(server.stdout.readline().strip())
    page.wait_for_selector("[data-output=ratio]")
    print(f"first page after {time.perf_counter() - start:.1f} s", flush=True)
    page.wait_for_selector("[data-drawings]", state="attached")
    page.evaluate(WATCH)
    _press_keys(page, 20, random.Random(SEED + 1))
    before, begin = _read_memory(server.pid), _read_processor_time(server.pid)
    times = _press_keys(page, events, random.Random(SEED))
    growth = _read_memory(server.pid) - before
    processor = 1e3 * (_read_processor_time(server.pid) - begin) / events
    return times, growth, processor


def _press_keys(page: Page, events: int, chance: random.Random) -> dict[str, list[float]]:
    """Press an arrow key on random sliders, and return the times of outputs and map, ms."""
    sliders = page.locator(".q-slider [tabindex]")
    count, times = sliders.count(), {"outputs": [], "map": []}  # type: tuple[int, dict[str, list[float]]]
    for _ in range(events):
        sliders.nth(chance.randrange(count)).press(chance.choice(("ArrowLeft", "ArrowRight")))
        page.wait_for_function("() => window.times.map !== undefined", timeout=PAUSE_MS)
        for name, value in page.evaluate("() => window.times").items():
            times[name].append(value)
    return times


def _list_processes(server: int) -> list[int]:
    """Return a server's process and its children (Linux)."""
    return [server, *map(int, Path(f"/proc/{server}/task/{server}/children").read_text().split())]


def _read_memory(server: int) -> float:
    """Return the memory that the processes of a server hold, MB (Linux)."""
    lines = [line for process in _list_processes(server) for line in Path(f"/proc/{process}/status").read_text().splitlines()]
    return sum(float(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS"))


def _read_processor_time(server: int) -> float:
    """Return the time of processors that the processes of a server have used, s (Linux)."""
    rows = [Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split() for process in _list_processes(server)]
    return sum(int(fields[11]) + int(fields[12]) for fields in rows) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    main()
