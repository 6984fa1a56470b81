"""Limit memory (bytes) and time (seconds) of one evaluation, checked before and during the work.

``with use_limits(Limits(...)):`` sets the limits inside the block; ``with start_clock():`` starts the clock of one evaluation.
Both hold in the thread in which they are set: work in other threads takes ``contextvars.copy_context()`` along.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from geometry.common.errors import InputError, Refusal, Words
from geometry.common.limits import format_minimum

LIBRARY_MEMORY_BYTES = 0.25e9  # bytes of a process that has loaded what it needs and not begun


@dataclass(frozen=True)
class Limits:
    """Limits of one evaluation.

    Attributes
    ----------
    memory
        Bytes, including those of the libraries.
    seconds
        From the request to the result.
    """

    memory: float = 2e9
    seconds: float = 120.0


class LimitReached(Refusal):
    """An evaluation that needs more memory or time than allowed; a larger limit may be enough."""


_CURRENT_LIMITS: ContextVar[Limits] = ContextVar("limits", default=Limits())  # noqa: B039 - frozen
_END_TIME: ContextVar[float | None] = ContextVar("end", default=None)


def get_limits() -> Limits:
    """Return the limits that are in force."""
    return _CURRENT_LIMITS.get()


@contextmanager
def use_limits(new_limits: Limits | None) -> Iterator[None]:
    """Set limits for the block; None leaves them unchanged. Raises ``InputError`` for anything else but ``Limits``."""
    if new_limits is not None and not isinstance(new_limits, Limits):
        raise InputError("limits", new_limits, "Limits(memory=..., seconds=...), or None")
    token = _CURRENT_LIMITS.set(new_limits or _CURRENT_LIMITS.get())
    try:
        yield
    finally:
        _CURRENT_LIMITS.reset(token)


@contextmanager
def start_clock() -> Iterator[None]:
    """Start the clock of an evaluation, unless a clock is running."""
    if _END_TIME.get() is not None:
        yield
        return
    token = _END_TIME.set(time.monotonic() + get_limits().seconds)
    try:
        yield
    finally:
        _END_TIME.reset(token)


def find_seconds_left() -> float:
    """Return the remaining seconds; infinity if no clock is running."""
    end = _END_TIME.get()
    return float("inf") if end is None else end - time.monotonic()


def check_time(work: str, seconds: float = 0.0) -> None:
    """Refuse work that takes ``seconds`` if less time is left; with 0 s refuse to continue.

    Raises
    ------
    LimitReached
        There is less time than that.
    """
    if find_seconds_left() > seconds:
        return
    spent = get_limits().seconds - find_seconds_left()
    takes = f"{work} takes {seconds:.0f} s more after {spent:.0f} s" if seconds else f"{work} after {spent:.0f} s"
    raise LimitReached("time", Words(f"{get_limits().seconds:g} s"), f"more for this scene: {takes} (--time raises the limit)")


def fits_in_memory(size: float) -> bool:
    """Return whether ``size`` bytes, in addition to the libraries, are within the memory limit."""
    return size + LIBRARY_MEMORY_BYTES <= get_limits().memory


def check_memory(work: str, size: float) -> None:
    """Refuse work that needs ``size`` bytes in addition to the libraries.

    Raises
    ------
    LimitReached
        That is more than is allowed.
    """
    if fits_in_memory(size):
        return
    allowed = (
        f"{format_minimum((size + LIBRARY_MEMORY_BYTES) / 1e9, 2)} GB or more for this scene: so much for {work} "
        "(--memory raises the limit)"
    )
    raise LimitReached("memory", Words(f"{get_limits().memory / 1e9:g} GB"), allowed)
