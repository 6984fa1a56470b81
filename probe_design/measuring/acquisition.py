"""Fit a reading while it comes, piece by piece, and show its last seconds; memory does not grow with its length."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

from hw.common.errors import HardwareError, InvalidSource
from hw.common.samples import Samples, join_samples
from hw.reader import Reader
from hw.signal.reading_fit import Losses, ReadingFit

SHOW_INTERVAL_S = 0.5  # s of samples between two displays, at least
BEHIND_INTERVAL_S = 5.0  # s added while samples wait, so that a display does not delay the fit
SHOW_INTERVAL_FRACTION = 0.05  # of the elapsed time between two displays: about a hundred in an hour


def fit_reading(
    reader: Reader,
    seconds: float | None,
    record: Path | None,
    running: ReadingFit,
    *,
    show: Callable[[Samples], None],
    last: float,
) -> None:
    """Fit all samples of a reading as they come; the raw bytes are written to disk first.

    Parameters
    ----------
    reader
        An open reader.
    seconds
        Duration; None: until the source ends.
    record
        A new file for the raw bytes, or None.
    running
        The fit that takes the samples.
    show
        Called with the latest samples, every SHOW_INTERVAL_S s or less often; its ``HardwareError`` is ignored.
    last
        Duration of the samples given to ``show``, s.

    Raises
    ------
    InvalidSource
        A recording without samples.
    HardwareError
        Of the reader.
    OSError
        Of the recording.
    """
    recent: list[Samples] = []
    last_shown = 0.0
    with closing(reader.blocks(seconds, record)) as blocks:  # type: ignore[type-var]
        for block in blocks:
            running.add(block)
            if not len(block):
                continue
            recent.append(block)
            while recent[0].index[-1] < block.index[-1] - last * block.rate:  # older than what is shown
                recent.pop(0)
            elapsed = (int(block.index[-1]) + 1) / block.rate  # s: indices start at 0
            next_show = last_shown + max(SHOW_INTERVAL_S, SHOW_INTERVAL_FRACTION * elapsed)
            if elapsed >= next_show + (BEHIND_INTERVAL_S if reader.is_behind else 0.0):
                last_shown = elapsed
                with suppress(HardwareError):  # too few periods of the load yet; faults are raised at the end
                    show(select_last(join_samples(recent), last))
    if not recent:
        raise InvalidSource("no samples: is the recording empty?")
    running.losses += Losses(notes=recent[-1].notes)  # closing may add a note on the recording


def select_last(samples: Samples, seconds: float) -> Samples:
    """Return the samples of the last ``seconds``."""
    rows = samples.index > samples.index[-1] - seconds * samples.rate
    return replace(samples, index=samples.index[rows], volts=samples.volts[rows], saturated=samples.saturated[rows])
