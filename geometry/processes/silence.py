"""Report that a process or server does not respond."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic

SILENCE_INTERVAL_S = 60.0  # seconds without a response between reports of it


class SilenceMonitor:
    """Report once a minute that something has not responded for some time."""

    def __init__(self, log: Callable[[str], None]) -> None:
        self._log = log
        self.reset()

    def reset(self) -> None:
        """Restart the clock after a response."""
        self._start_time, self._report_count = monotonic(), 0

    def report(self, text: str, remedy: str, min_silence: float = 0.0) -> None:
        """Log ``text`` with the silent time and a remedy, once a minute and not before ``min_silence`` seconds."""
        seconds = monotonic() - self._start_time
        if seconds >= max((self._report_count + 1) * SILENCE_INTERVAL_S, min_silence):
            self._report_count = int(seconds // SILENCE_INTERVAL_S)
            self._log(f"{text} for {seconds:.0f} s; {remedy}, or wait")
