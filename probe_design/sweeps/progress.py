"""Progress of a sweep, and its log file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
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
        Number of designs.
    done
        Designs with a row, including those of earlier runs.
    refused, failed
        Number of these that were refused, and that failed.
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


ReportProgress = Callable[[Progress], None]


def report_at_intervals(write_line: Callable[[str], None]) -> ReportProgress:
    """Return a function that writes the state as a line, at most once in ``LOG_INTERVAL_S``, and at the end."""
    last_time = -LOG_INTERVAL_S  # the first report is written

    def report(state: Progress) -> None:
        """Write the state if it is due."""
        nonlocal last_time
        if monotonic() - last_time >= LOG_INTERVAL_S or state.done == state.total:
            last_time = monotonic()
            write_line(state.describe())

    return report


@contextmanager
def open_log(folder: Path) -> Iterator[Callable[[str], None]]:
    """Yield a function that appends a line to the log of a sweep."""
    with (folder / LOG_FILE).open("a", encoding="utf-8") as log:

        def log_line(text: str) -> None:
            """Append a line with the time in UTC."""
            with suppress(OSError):  # the store reports a full disk
                log.write(f"{datetime.now(UTC).isoformat(timespec='seconds')} {text}\n")
                log.flush()

        yield log_line
