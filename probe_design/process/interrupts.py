"""Signals that ask the program to end: Ctrl-C, SIGTERM and SIGHUP. Whatever they land in, it ends with one line and 128 + number.

Each raises ``KeyboardInterrupt``, as Ctrl-C does in every Python program, so that all that is under way clears up after itself.
Three things are different from Python's own way: libraries are not torn out of their import, for those in C crash or say what
nobody understands; what a library swallows is raised again, every ``AGAIN`` seconds; and what is clearing up is left to do so.
"""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from types import FrameType
from typing import Any

AGAIN = 0.05  # s
WORDS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}
_TIMER = hasattr(signal, "setitimer")  # not on Windows, where nothing is raised a second time
_ROOT = __file__.rsplit(os.sep, 3)[0]
_OURS = tuple(os.path.join(_ROOT, name, "") for name in ("geometry", "hw", "probe_design", "solver"))
_came = 0


def minded(program: Callable[[], int]) -> int:
    """Run a program that ends by the signals which this process does not ignore, as it does under ``nohup``.

    Returns:
        Its exit code, or 128 + the number of the signal that ended it.
    """
    try:
        for name in WORDS:
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, _heard)
        if _TIMER:
            signal.signal(signal.SIGALRM, _heard)
        return program()
    except BaseException as fault:
        if _came or isinstance(fault, KeyboardInterrupt):
            return told()
        raise


def came() -> bool:
    """Say whether one of the signals has come."""
    return bool(_came)


def told() -> int:
    """Write the line that says how the program ended, and return its exit code."""
    if _came:
        _deaf()
    number = signal.Signals(_came or signal.SIGINT)
    line = f"probe-design: {WORDS.get(number.name, number.name)}; nothing half-written is left"
    with suppress(OSError, ValueError):  # a terminal that has hung up
        print(line, file=getattr(sys.stderr, "rich_proxied_file", sys.stderr), flush=True)
    return 128 + number


def leave(code: int) -> None:
    """End the process; nothing is listened to any more, and neither libraries nor Python add to what has been said."""
    _deaf()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        sys.stdout.flush()
    except (OSError, AttributeError):  # which has been told
        os.dup2(nowhere, 1)
    if _came:
        os.dup2(nowhere, 2)
    sys.exit(code)


def _deaf() -> None:
    for name in WORDS:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    if _TIMER:
        signal.setitimer(signal.ITIMER_REAL, 0)


def _heard(number: int, frame: FrameType | None) -> None:
    """Note the first signal; raise, unless a library is being imported or something is clearing up."""
    global _came
    if not _came:
        _came = number
        sys.unraisablehook = threading.excepthook = _unheard
        sys.stderr = _Silence(sys.stderr)
        if _TIMER:
            signal.setitimer(signal.ITIMER_REAL, AGAIN, AGAIN)
    if not _clearing_up() and not (_TIMER and _importing(frame)):
        raise KeyboardInterrupt


def _unheard(fault: object) -> None:
    """Say nothing of what an interrupt has torn where nobody could catch it."""


class _Silence(io.TextIOBase):
    """Standard error for libraries that tell of an interrupt; what rich draws it still takes away itself."""

    def __init__(self, stream: Any) -> None:
        self.rich_proxied_file = getattr(stream, "rich_proxied_file", stream)  # where rich writes to

    def write(self, text: str) -> int:
        """Write nothing."""
        return len(text)


def _clearing_up() -> bool:
    """Whether a ``KeyboardInterrupt`` is being handled, or something that came of it."""
    fault = sys.exception()
    while fault is not None and not isinstance(fault, KeyboardInterrupt):
        fault = fault.__context__
    return fault is not None


def _importing(frame: FrameType | None) -> bool:
    """Whether the module of a library is being run for the first time."""
    library = False
    while frame is not None:
        code = frame.f_code
        if library and code.co_filename.startswith("<frozen importlib"):
            return True
        library = library or (code.co_name == "<module>" and not code.co_filename.startswith(_OURS))
        frame = frame.f_back
    return False
