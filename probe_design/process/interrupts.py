"""Handle signals that end the program: Ctrl-C, SIGTERM and SIGHUP. It ends with one line of text and exit code 128 + number.

Each signal raises ``KeyboardInterrupt``, as Ctrl-C does in every Python program, so that running code can clean up. Three rules
differ from Python's own handler. An import of a library is not interrupted, as C libraries crash or print obscure messages then.
The exception is raised again every ``RERAISE_INTERVAL_S`` seconds, as a library may swallow it. Code that is cleaning up is not
interrupted again.
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

RERAISE_INTERVAL_S = 0.05  # s
SIGNAL_WORDS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}
_HAS_TIMER = hasattr(signal, "setitimer")  # not on Windows, where the exception is raised only once
_SOURCE_ROOT = __file__.rsplit(os.sep, 3)[0]
_OWN_FOLDERS = tuple(os.path.join(_SOURCE_ROOT, name, "") for name in ("geometry", "hw", "probe_design", "solver"))
_signal_number = 0


def run_interruptible(program: Callable[[], int]) -> int:
    """Run a program that ends at a signal. Signals that this process ignores, as under ``nohup``, stay ignored.

    Returns
    -------
    int
        The exit code of the program, or 128 + the number of the signal that ended it.
    """
    try:
        for name in SIGNAL_WORDS:
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, _handle_signal)
        if _HAS_TIMER:
            signal.signal(signal.SIGALRM, _handle_signal)
        return program()
    except BaseException as fault:
        if _signal_number or isinstance(fault, KeyboardInterrupt):
            return report_end()
        raise


def has_signal() -> bool:
    """Return whether a signal has arrived."""
    return bool(_signal_number)


def report_end() -> int:
    """Write the line that reports the signal, and return the exit code."""
    if _signal_number:
        _ignore_signals()
    number = signal.Signals(_signal_number or signal.SIGINT)
    line = f"probe-design: {SIGNAL_WORDS.get(number.name, number.name)}; nothing half-written is left"
    with suppress(OSError, ValueError):  # the terminal may be closed
        print(line, file=getattr(sys.stderr, "rich_proxied_file", sys.stderr), flush=True)
    return 128 + number


def leave(code: int) -> None:
    """End the process; signals are ignored from now on, and neither libraries nor Python print anything more."""
    _ignore_signals()
    null_device = os.open(os.devnull, os.O_WRONLY)
    try:
        sys.stdout.flush()
    except (OSError, AttributeError):  # already reported
        os.dup2(null_device, 1)
    if _signal_number:
        os.dup2(null_device, 2)
    sys.exit(code)


def _ignore_signals() -> None:
    """Ignore all signals that end the program, and stop the timer."""
    for name in SIGNAL_WORDS:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    if _HAS_TIMER:
        signal.setitimer(signal.ITIMER_REAL, 0)


def _handle_signal(number: int, frame: FrameType | None) -> None:
    """Store the first signal; raise, unless a library is being imported or code is cleaning up."""
    global _signal_number
    if not _signal_number:
        _signal_number = number
        sys.unraisablehook = threading.excepthook = _ignore_fault
        sys.stderr = _SilentStream(sys.stderr)
        if _HAS_TIMER:
            signal.setitimer(signal.ITIMER_REAL, RERAISE_INTERVAL_S, RERAISE_INTERVAL_S)
    if not _is_clearing_up() and not (_HAS_TIMER and _is_importing(frame)):
        raise KeyboardInterrupt


def _ignore_fault(fault: object) -> None:
    """Ignore an exception that an interrupt raised where it cannot be caught."""


class _SilentStream(io.TextIOBase):
    """Standard error that discards the text of libraries about an interrupt; rich can still erase its own output."""

    def __init__(self, stream: Any) -> None:
        """Replace ``stream``, and keep the stream that rich writes to."""
        self.rich_proxied_file = getattr(stream, "rich_proxied_file", stream)  # where rich writes to

    def write(self, text: str) -> int:
        """Write nothing."""
        return len(text)


def _is_clearing_up() -> bool:
    """Return whether a ``KeyboardInterrupt``, or an exception that it caused, is being handled."""
    fault = sys.exception()
    while fault is not None and not isinstance(fault, KeyboardInterrupt):
        fault = fault.__context__
    return fault is not None


def _is_importing(frame: FrameType | None) -> bool:
    """Return whether the module of a library is being imported at this frame or one of its callers."""
    in_library = False  # a frame further in is the body of a library's module
    while frame is not None:
        code = frame.f_code
        if in_library and code.co_filename.startswith("<frozen importlib"):
            return True
        in_library = in_library or (code.co_name == "<module>" and not code.co_filename.startswith(_OWN_FOLDERS))
        frame = frame.f_back
    return False
