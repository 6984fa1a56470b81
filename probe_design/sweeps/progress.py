"""Progress of a sweep, and its log file."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic

LOG_FILE = "sweep.log"
LOG_INTERVAL_S = 10.0  # seconds between lines of progress


@dataclass(frozen=True)
class Progress:
    """The state of a running sweep.

    Attributes
    ----------
    total
        designs.
    done
        Designs with a row, including those of earlier runs.
    refused, failed
        How many of these were refused, failed.
    rate
        Rows per second in this run; 0 before the first.
    workers
        Number of workers.
    """

    total: int
    done: int
    refused: int
    failed: int
    rate: float
    workers: int

    @property
    def seconds_left(self) -> float | None:
        """Remaining time at this rate, s; None before the first row."""
        return (self.total - self.done) / self.rate if self.rate else None

    def describe(self) -> str:
        """Describe the progress in one line."""
        time_left = "-" if self.seconds_left is None else f"{self.seconds_left:.0f} s"
        counts = f"{self.done} of {self.total} done, {self.refused} refused, {self.failed} failed"
        return f"{counts}, {self.rate:.3g} rows/s on {self.workers} workers, {time_left} left"


Tell = Callable[[Progress], None]


@contextmanager
def open_log(folder: Path, tell: Tell | None) -> Iterator[tuple[Tell, Callable[[str], None]]]:
    """Yield a function that logs the state at most every ten seconds, and one that logs a line; both flush."""
    last_time = -LOG_INTERVAL_S
    with (folder / LOG_FILE).open("a", encoding="utf-8") as log:

        def log_line(text: str) -> None:
            with contextlib.suppress(OSError):  # the store reports a full disk
                log.write(f"{datetime.now(UTC).isoformat(timespec='seconds')} {text}\n")
                log.flush()

        def report_state(state: Progress) -> None:
            nonlocal last_time
            if monotonic() - last_time >= LOG_INTERVAL_S or state.done == state.total:
                last_time = monotonic()
                log_line(state.describe())
            if tell is not None:
                tell(state)

        yield report_state, log_line
