"""Protect short steps from Ctrl-C and the other signals that end a program."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

DEFERRED_SIGNALS = (
    "SIGINT",
    "SIGTERM",
    "SIGHUP",
    "SIGALRM",
)  # the last reminds of the others, see ``probe_design.process.interrupts``


@contextmanager
def defer_signals() -> Iterator[None]:
    """Defer the signals that end a program until the block ends; in threads other than the main one do nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    numbers = [getattr(signal, name) for name in DEFERRED_SIGNALS if hasattr(signal, name)]
    handlers = {number: signal.getsignal(number) for number in numbers if callable(signal.getsignal(number))}
    for number in handlers:
        signal.signal(number, lambda number, _: received.append(number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    for number in received:
        signal.raise_signal(number)
