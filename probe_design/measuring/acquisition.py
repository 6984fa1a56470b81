"""A reading as it comes: fitted piece by piece, its last seconds shown, none of it held."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from hw.common.errors import HardwareError, InvalidSource
from hw.common.samples import Samples, joined
from hw.reader import Reader
from hw.signal.measure import Losses
from hw.signal.running import RunningFit

EVERY = 0.5  # s of samples between two looks, and
SELDOM = 5.0  # s more where samples wait: what comes faster than it is fitted is shown, too
SHARE = 0.05  # of the time that passed, so that an hour has a hundred


def collected(
    reader: Reader,
    seconds: float | None,
    record: Path | None,
    running: RunningFit,
    *,
    show: Callable[[Samples], None],
    last: float,
) -> None:
    """Fit all samples of a reading as they come; the raw bytes are on disk before.

    Args:
        reader: open.
        seconds: how long; None: until the source ends.
        record: a new file for the raw bytes, or None.
        running: takes the samples.
        show: given the last seconds that came, every EVERY s of them; what it raises as ``HardwareError`` is passed over.
        last: how many seconds that are.

    Raises:
        InvalidSource: a recording without samples.
        HardwareError: of the reader.
        OSError: of the recording.
    """
    recent: list[Samples] = []
    shown = 0.0
    with closing(reader.blocks(seconds, record)) as blocks:  # type: ignore[type-var]
        for block in blocks:
            running.add(block)
            if not len(block):
                continue
            recent.append(block)
            while recent[0].index[-1] < block.index[-1] - last * block.rate:
                recent.pop(0)
            now = (int(block.index[-1]) + 1) / block.rate
            due = shown + max(EVERY, SHARE * now)
            if now >= due + (SELDOM if reader.behind else 0.0):
                shown = now
                _shown(show, window(joined(recent), last))
    if not recent:
        raise InvalidSource("no samples: is the recording empty?")
    running.losses += Losses(notes=recent[-1].notes)  # a recording may fail where it is closed


def window(samples: Samples, seconds: float) -> Samples:
    """Return the last ``seconds`` of samples."""
    rows = samples.index > samples.index[-1] - seconds * samples.rate
    return replace(samples, index=samples.index[rows], volts=samples.volts[rows], saturated=samples.saturated[rows])


def _shown(show: Callable[[Samples], None], samples: Samples) -> None:
    try:
        show(samples)
    except HardwareError:  # too little of the load yet: the whole reading is judged at its end
        return
