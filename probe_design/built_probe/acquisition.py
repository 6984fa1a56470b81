"""Samples collected by a thread that waits for nobody, while what came so far is shown."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from threading import Event, Thread

from hw.common.errors import HardwareError, InvalidSource
from hw.common.samples import Samples, joined
from hw.reader import Reader

EVERY = 0.5  # s of samples between two looks


def collected(reader: Reader, seconds: float | None, record: Path | None, show: Callable[[Samples], None]) -> Samples:
    """Return all samples of a reading.

    Args:
        reader: open.
        seconds: how long; None: until the source ends.
        record: a new file for the raw bytes, or None.
        show: given all that came so far, every EVERY s of it; what it raises as ``HardwareError`` is passed over.

    Raises:
        InvalidSource: a recording without samples.
        HardwareError: of the reader.
        OSError: of the recording.
    """
    blocks: SimpleQueue[Samples | BaseException | None] = SimpleQueue()
    stop = Event()
    thread = Thread(target=_read, args=(reader, seconds, record, blocks, stop), daemon=True)
    thread.start()
    parts: list[Samples] = []
    shown = 0.0
    try:
        while (block := blocks.get()) is not None:
            if isinstance(block, BaseException):
                raise block
            parts.append(block)
            now = (int(block.index[-1]) + 1) / block.rate if len(block) else shown
            if now >= shown + EVERY and blocks.empty():
                shown = now
                _shown(show, parts)
    finally:
        stop.set()
        thread.join()
    if not parts:
        raise InvalidSource("no samples: is the recording empty?")
    return joined(parts)


def window(samples: Samples, seconds: float) -> Samples:
    """Return the last ``seconds`` of samples."""
    rows = samples.index > samples.index[-1] - seconds * samples.rate
    return replace(samples, index=samples.index[rows], volts=samples.volts[rows], saturated=samples.saturated[rows])


def _shown(show: Callable[[Samples], None], parts: list[Samples]) -> None:
    parts[:] = [joined(parts)]
    try:
        show(parts[0])
    except HardwareError:  # too little of the load yet: the whole reading is judged at its end
        return


def _read(
    reader: Reader, seconds: float | None, record: Path | None, blocks: SimpleQueue[Samples | BaseException | None], stop: Event
) -> None:
    try:
        with closing(reader.blocks(seconds, record)) as stream:  # type: ignore[type-var]
            for block in stream:
                blocks.put(block)
                if stop.is_set():
                    break
    except BaseException as fault:  # handed on to the other thread
        blocks.put(fault)
    blocks.put(None)
