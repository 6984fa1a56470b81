"""Limits of memory (bytes) and time (seconds) of one evaluation, checked before and during the work.

``with use_limits(Limits(...)):`` sets the limits inside the block; ``with start_clock():`` starts the clock of one evaluation.
Both hold in the thread in which they are set: work in other threads takes ``contextvars.copy_context()`` along.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from geometry.common.errors import Refusal, Words
from geometry.common.limits import least

LIBRARIES = 0.25e9  # bytes of a process that has loaded what it needs and not begun


@dataclass(frozen=True)
class Limits:
    """Limits of one evaluation.

    Attributes:
        memory: bytes, including those of the libraries.
        seconds: from the request to the result.
    """

    memory: float = 2e9
    seconds: float = 120.0


class LimitReached(Refusal):
    """An evaluation that needs more memory or time than allowed; a larger limit may be enough."""


_LIMITS: ContextVar[Limits] = ContextVar("limits", default=Limits())  # noqa: B039 - frozen
_END: ContextVar[float | None] = ContextVar("end", default=None)


def limits() -> Limits:
    """Return the limits that are in force."""
    return _LIMITS.get()


@contextmanager
def limited(some: Limits | None) -> Iterator[None]:
    """Set limits for the block; None leaves them unchanged."""
    token = _LIMITS.set(some or _LIMITS.get())
    try:
        yield
    finally:
        _LIMITS.reset(token)


@contextmanager
def timed() -> Iterator[None]:
    """Start the clock of an evaluation, unless a clock is running."""
    if _END.get() is not None:
        yield
        return
    token = _END.set(time.monotonic() + limits().seconds)
    try:
        yield
    finally:
        _END.reset(token)


def seconds_left() -> float:
    """Return the remaining seconds; infinity if no clock is running."""
    end = _END.get()
    return float("inf") if end is None else end - time.monotonic()


def check_time(work: str, seconds: float = 0.0) -> None:
    """Refuse work that takes ``seconds`` if less time is left; with 0 s refuse to continue.

    Raises:
        LimitReached: there is less time than that.
    """
    if seconds_left() > seconds:
        return
    spent = limits().seconds - seconds_left()
    takes = f"{work} takes {seconds:.0f} s more after {spent:.0f} s" if seconds else f"{work} after {spent:.0f} s"
    raise LimitReached("time", Words(f"{limits().seconds:g} s"), f"more for this scene: {takes} (--time raises the limit)")


def has_room(size: float) -> bool:
    """Return whether ``size`` bytes, in addition to the libraries, are within the memory limit."""
    return size + LIBRARIES <= limits().memory


def check_memory(work: str, size: float) -> None:
    """Refuse work that needs ``size`` bytes in addition to the libraries.

    Raises:
        LimitReached: that is more than is allowed.
    """
    if has_room(size):
        return
    allowed = f"{least((size + LIBRARIES) / 1e9, 2)} GB or more for this scene: so much for {work} (--memory raises the limit)"
    raise LimitReached("memory", Words(f"{limits().memory / 1e9:g} GB"), allowed)
