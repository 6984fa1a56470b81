"""Progress of a sweep, and its log file."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic

LOG = "sweep.log"
EVERY = 10.0  # seconds between lines of progress
SILENT = 60.0  # seconds without a response between reports of it


@dataclass(frozen=True)
class Progress:
    """The state of a running sweep.

    Attributes:
        total: designs.
        done: designs with a row, including those of earlier runs.
        refused, failed: how many of these were refused, failed.
        rate: rows per second in this run; 0 before the first.
        workers: number of workers.
    """

    total: int
    done: int
    refused: int
    failed: int
    rate: float
    workers: int

    @property
    def left(self) -> float | None:
        """Remaining time at this rate, s; None before the first row."""
        return (self.total - self.done) / self.rate if self.rate else None

    def line(self) -> str:
        """Describe the progress in one line."""
        left = "-" if self.left is None else f"{self.left:.0f} s"
        counts = f"{self.done} of {self.total} done, {self.refused} refused, {self.failed} failed"
        return f"{counts}, {self.rate:.3g} rows/s on {self.workers} workers, {left} left"


Tell = Callable[[Progress], None]


class Silence:
    """Report once a minute that something has not responded for some time."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self.heard()

    def heard(self) -> None:
        """Restart the clock after a response."""
        self._since, self._told = monotonic(), 0

    def tell(self, text: str, remedy: str, after: float = 0.0) -> None:
        """Log ``text`` with the silent time and a remedy, once a minute and not before ``min_silence`` seconds."""
        silent = monotonic() - self._since
        if silent >= max((self._told + 1) * SILENT, after):
            self._told = int(silent // SILENT)
            self._say(f"{text} for {silent:.0f} s; {remedy}, or wait")


@contextmanager
def logged(folder: Path, tell: Tell | None) -> Iterator[tuple[Tell, Callable[[str], None]]]:
    """Yield a function that logs the state at most every ten seconds, and one that logs a line; both flush."""
    last = -EVERY
    with (folder / LOG).open("a", encoding="utf-8") as log:

        def line(text: str) -> None:
            with contextlib.suppress(OSError):  # the store reports a full disk
                log.write(f"{datetime.now(UTC).isoformat(timespec='seconds')} {text}\n")
                log.flush()

        def update(state: Progress) -> None:
            nonlocal last
            if monotonic() - last >= EVERY or state.done == state.total:
                last = monotonic()
                line(state.line())
            if tell is not None:
                tell(state)

        yield update, line
