"""The program interrupted by a signal at a chosen moment, and what it leaves behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

BEGIN = (
    "import os, sys; from probe_design.__main__ import main; "
    "began = int(sys.argv.pop(1)); os.write(began, b'.'); os.close(began); main()"
)
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
PATIENCE = 250.0  # s


@dataclass(frozen=True)
class Leftovers:
    """What a run of the program has left: exit code, standard error, files in its output folder and among temporary ones."""

    code: int
    said: str
    files: frozenset[str]
    temporary: frozenset[str]
    seconds: float

    def wrong(self, number: int, whole: Leftovers) -> str:
        """Say what is wrong after a signal, beside what an uninterrupted run leaves; empty if nothing is."""
        if self.temporary or any(name.startswith(".") for name in self.files):
            return f"temporary files: {sorted(self.temporary | self.files)}"
        if (self.code, self.files) == (whole.code, whole.files):  # it had finished, but for its own end
            return ""
        if self.code == -number and not self.said:  # before it listened: the system's way, which a shell tells as 128 + number
            return ""
        if self.code != 128 + number:
            return f"exit code {self.code}: {self.said}"
        if len([line for line in self.said.splitlines() if not line.startswith("probe-design: ")]) or "defect" in self.said:
            return f"said {self.said}"
        kept = "sweep.sqlite" in self.files or self.files in (frozenset(), whole.files)  # a sweep keeps what it has
        return "" if kept else f"some of the files: {sorted(self.files)}"


def left(words: Sequence[str], delay: float = 0.0, number: int = 0) -> Leftovers:
    """Run the program, OUT in its words standing for a new folder, and send it a signal ``delay`` s after its start."""
    for signal_number in SIGNALS:
        if (
            signal.getsignal(signal_number) is signal.SIG_IGN
        ):  # a shell's way with what it runs in the background, which children inherit
            signal.signal(signal_number, signal.SIG_DFL)
    with tempfile.TemporaryDirectory() as output, tempfile.TemporaryDirectory() as temporary:
        waiting, begins = os.pipe()
        command = [sys.executable, "-c", BEGIN, str(begins), *(word.replace("OUT", output) for word in words)]
        environment = os.environ | {"TMPDIR": temporary}
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
            pass_fds=[begins],
        )  # fmt: skip
        os.close(begins)
        os.read(waiting, 1)
        os.close(waiting)
        start = time.monotonic()
        if number:
            try:
                process.wait(delay)
            except subprocess.TimeoutExpired:
                process.send_signal(number)
        said = process.communicate(timeout=PATIENCE)[1]
        seconds = time.monotonic() - start
        return Leftovers(process.returncode, said, _names(output), _names(temporary), seconds)


def moments(seconds: float, count: int, seed: int | Sequence[int]) -> Iterator[tuple[float, int]]:
    """Yield delays from the start to the end of a run of so many seconds, and a signal for each: half of them Ctrl-C."""
    random = np.random.default_rng(seed)
    for _ in range(count):
        yield float(random.uniform(0, seconds)), int(random.choice([signal.SIGINT, *SIGNALS]))


def _names(folder: str) -> frozenset[str]:
    return frozenset(path.relative_to(folder).as_posix() for path in Path(folder).rglob("*"))
