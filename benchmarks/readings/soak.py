"""Stream an hour at 10 kS/s, faster than real time.

    nice python -m benchmarks.readings.soak [--seconds 3600] [--rate 10000]

A virtual probe streams through decoder, recorder and fit as a real one does. It prints the largest memory, samples lost, what is
on disk, and how far the result is off. `--full MB` lets the disk be full after so much. `--command` runs `probe-design read`,
with its prediction, its lines and its JSON object.

Duration: minutes.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.readings.faults import AMPLIFIER, AMPLITUDES, FREQUENCY, NOISE, SENSITIVITY
from hw.common.samples import Floats
from hw.reader import Reader
from hw.recordings.recording import Recording
from hw.signal.measurement import measure
from hw.signal.reading_fit import ReadingFit
from hw.simulation.virtual import make_virtual_probe

REPORT_INTERVAL_S = 300.0  # s between two lines


def signals(seed: int = 0) -> Callable[[Floats], Floats]:
    """Return the virtual probe's volts at times (n,): load, mains and noise."""
    random = np.random.default_rng(seed)

    def volts(times: Floats) -> Floats:
        load = (AMPLITUDES * np.exp(2j * np.pi * FREQUENCY * times)[:, None]).real
        mains = 4e-4 * np.cos(2 * np.pi * 50.03 * times)
        return np.asarray(load + np.outer(mains, [1.0, 0.7, 0.1]) + NOISE * random.standard_normal(load.shape))

    return volts


def memory() -> float:
    """Return the most that the process has held, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def soak(seconds: float, rate: float, path: Path) -> None:
    """Read, record and fit for so long, and print what came of it."""
    begun, start_memory, running, shown = time.monotonic(), memory(), ReadingFit(round(FREQUENCY), force=True), 0.0
    print(f"{start_memory:.0f} MB before the first sample")
    rows, last, gaps = 0, 0, 0
    notes: tuple[str, ...] = ()
    with Reader.open(make_virtual_probe(signals(), rate, channels=3, scale=1e-6)) as reader:
        for block in reader.blocks(seconds, path):
            running.add(block)
            rows, last, gaps, notes = rows + len(block), int(block.index[-1]), gaps + len(block.gaps), block.notes
            if last / rate >= shown + REPORT_INTERVAL_S:
                shown = last / rate
                print(f"{shown:6.0f} s of samples after {time.monotonic() - begun:4.0f} s: {memory():.0f} MB", flush=True)
    measurement = measure(running, (AMPLIFIER, AMPLIFIER), SENSITIVITY)
    gain_error = abs(measurement.charges * AMPLIFIER.response(measurement.fit.frequency)) / np.abs(AMPLITUDES[:2]) - 1
    spread = np.sqrt(np.diag(measurement.covariance)[::2]) / abs(measurement.charges)
    print(f"{rows} rows of {last + 1}, {gaps} gaps; the process held {memory():.0f} MB at most")
    print(f"inner off by {gain_error[0]:.1e} (sd {spread[0]:.1e}), outer by {gain_error[1]:.1e} (sd {spread[1]:.1e})")
    print(
        f"on disk {path.stat().st_size / 1e6:.0f} MB, cut: {describe_recording(path)}; {time.monotonic() - begun:.0f} s; {notes}"
    )


def run_command(seconds: float, rate: float, path: Path) -> None:
    """Run `read --virtual` for so long at so many samples per second, and print what it held."""
    from probe_design.commands import hardware_sources
    from probe_design.commands.main import cli

    vars(hardware_sources)["SAMPLE_RATE_HZ"] = rate
    begun = time.monotonic()
    words = ["read", "examples/scene.toml", "--virtual", "--seconds", f"{seconds:g}", "--record", str(path), "--json"]
    cli.main(words, standalone_mode=False)
    size, took = path.stat().st_size / 1e6, time.monotonic() - begun
    print(f"the process held {memory():.0f} MB at most; on disk {size:.0f} MB; {took:.0f} s")


def describe_recording(path: Path) -> str:
    """Return how many bytes of frames a recording holds, and whether it was cut."""
    recording = Recording(path)
    size = sum(len(chunk.data) for chunk in recording.read_chunks())
    return f"{recording.cut is not None}, frames {size / 1e6:.0f} MB"


def main() -> None:
    """Run it in a folder that is removed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--rate", type=float, default=10_000.0)
    parser.add_argument("--full", type=float, help="MB after which the disk is full")
    parser.add_argument("--command", action="store_true", help="run the command read")
    given = parser.parse_args()
    if given.full:
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(given.full * 1e6), resource.RLIM_INFINITY))
    with tempfile.TemporaryDirectory() as folder:
        (run_command if given.command else soak)(given.seconds, given.rate, Path(folder) / "run.probe")


if __name__ == "__main__":
    main()
