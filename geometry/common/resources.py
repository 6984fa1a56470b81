"""What one answer may take: bytes and seconds. Work asks here before it begins, and while it lasts.

``with limited(Limits(...)):`` sets the limits for all that is asked for inside; ``with timed():`` starts the clock of one answer.
Both hold in the thread they are set in: work given to others takes ``contextvars.copy_context()`` along.
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
    """What one answer may take.

    Attributes:
        memory: bytes, the libraries' own included.
        seconds: from the question to the answer.
    """

    memory: float = 2e9
    seconds: float = 120.0


class LimitReached(Refusal):
    """An answer that would take more memory or time than is allowed; a larger limit may bring it."""


_LIMITS: ContextVar[Limits] = ContextVar("limits", default=Limits())  # noqa: B039 - frozen
_END: ContextVar[float | None] = ContextVar("end", default=None)


def limits() -> Limits:
    """Return the limits that hold here."""
    return _LIMITS.get()


@contextmanager
def limited(some: Limits | None) -> Iterator[None]:
    """Set other limits; None leaves them as they are."""
    token = _LIMITS.set(some or _LIMITS.get())
    try:
        yield
    finally:
        _LIMITS.reset(token)


@contextmanager
def timed() -> Iterator[None]:
    """Start the clock of an answer, unless it is part of one whose clock is running."""
    if _END.get() is not None:
        yield
        return
    token = _END.set(time.monotonic() + limits().seconds)
    try:
        yield
    finally:
        _END.reset(token)


def seconds_left() -> float:
    """Return what is left of the time; infinity while no clock is running."""
    end = _END.get()
    return float("inf") if end is None else end - time.monotonic()


def check_time(work: str, seconds: float = 0.0) -> None:
    """Refuse work that is to begin now and takes so many seconds, or to go on with it.

    Raises:
        LimitReached: there is less time than that.
    """
    if seconds_left() > seconds:
        return
    spent = limits().seconds - seconds_left()
    takes = f"{work} takes {seconds:.0f} s more after {spent:.0f} s" if seconds else f"{work} after {spent:.0f} s"
    raise LimitReached("time", Words(f"{limits().seconds:g} s"), f"more for this scene: {takes} (--time raises the limit)")


def has_room(size: float) -> bool:
    """Return whether work that holds so many bytes beside the libraries is within the limit."""
    return size + LIBRARIES <= limits().memory


def check_memory(work: str, size: float) -> None:
    """Refuse work that holds so many bytes beside the libraries.

    Raises:
        LimitReached: that is more than is allowed.
    """
    if has_room(size):
        return
    allowed = f"{least((size + LIBRARIES) / 1e9, 2)} GB or more for this scene: so much for {work} (--memory raises the limit)"
    raise LimitReached("memory", Words(f"{limits().memory / 1e9:g} GB"), allowed)
