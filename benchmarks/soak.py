"""Read at 100 kS/s for a while and say what it costs: ``python benchmarks/soak.py [--seconds 60]``.

Each line is a process of its own. "virtual": the virtual probe, whose making of samples is counted with the reading;
"libusb": a board emulated in another process under umockdev (as tests/test_hw_usb.py needs it), read through the real libusb.
Columns: frame size, whether raw bytes are recorded too, rate kept (kS/s per channel, by the clock), share of one processor (%,
this process without the comparing), memory when reading began and its growth until the end (MB), samples lost, samples that are
not what their index calls for.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from hw.common.samples import Floats
from hw.reader import Reader
from hw.simulation.virtual import virtual

ROOT = Path(__file__).parents[1]
RATE, SCALE, PERIOD = 100_000.0, 2.0**-12, 65536


def expected(index: NDArray[np.int64]) -> Floats:
    """Return the volts of tests/usb_emulator.py at these indices."""
    codes = np.column_stack([7919 * (index % PERIOD), 104729 * (index % PERIOD) + 12345]) % PERIOD
    return codes.astype(np.uint16).view(np.int16).astype(np.float64) * SCALE


def soak(source: str, packet: int, recorded: bool, seconds: float) -> dict[str, float]:
    """Return what one run measured."""
    probe = virtual(lambda t: expected(np.rint(t * RATE).astype(np.int64)), RATE, scale=SCALE, packet=packet, pace=True)
    lost = wrong = rows = 0
    with tempfile.TemporaryDirectory() as folder, Reader.open(probe if source == "virtual" else "usb") as reader:
        blocks = reader.blocks(seconds, Path(folder, "run.probe") if recorded else None)
        next(blocks)
        begin, used, memory = time.monotonic(), time.process_time(), resident()
        for block in blocks:
            comparing = time.process_time()
            rows += len(block)
            lost += sum(gap.count for gap in block.gaps)
            wrong += int(np.count_nonzero(block.volts != expected(block.index)))
            used += time.process_time() - comparing
        clock, used = time.monotonic() - begin, time.process_time() - used
    growth = resident() - memory
    return {
        "rate": rows / clock / 1e3,
        "cpu": 100 * used / clock,
        "memory": memory,
        "growth": growth,
        "lost": lost,
        "wrong": wrong,
    }


def resident() -> float:
    """Return the most memory that this process has held, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 if sys.platform.startswith("linux") else 1024**2)


def in_a_process(source: str, packet: int, recorded: bool, seconds: float) -> dict[str, float]:
    """Run ``soak`` apart, among emulated devices if it needs one."""
    command = [sys.executable, __file__, "--one", source, str(packet), str(int(recorded)), "--seconds", str(seconds)]
    if source == "libusb":
        devices = json.dumps([{"serial": "A1", "packet": packet, "pace": True}])
        command = ["umockdev-wrapper", "/usr/bin/python3", str(ROOT / "tests" / "usb_emulator.py"), devices, *command]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    ended = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, env=environment)
    found: dict[str, float] = json.loads(ended.stdout)
    return found


def main() -> None:
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--seconds", type=float, default=60.0)
    arguments.add_argument("--one", nargs=3)
    asked = arguments.parse_args()
    if asked.one:
        print(json.dumps(soak(asked.one[0], int(asked.one[1]), asked.one[2] == "1", asked.seconds)))
        return
    table = Table(title=f"two channels at {RATE / 1e3:g} kS/s for {asked.seconds:g} s")
    for heading in ("source", "frame", "recorded", "kS/s", "CPU %", "MB", "growth", "lost", "wrong"):
        table.add_column(heading, justify="left" if heading == "source" else "right")
    for source, packet, recorded in (
        ("virtual", 512, False),
        ("libusb", 512, False),
        ("libusb", 512, True),
        ("libusb", 64, True),
    ):
        found = in_a_process(source, packet, recorded, asked.seconds)
        numbers = (f"{found[key]:.4g}" for key in ("rate", "cpu", "memory", "growth", "lost", "wrong"))
        table.add_row(source, str(packet), "yes" if recorded else "no", *numbers)
    Console().print(table)


if __name__ == "__main__":
    main()
