"""Memory that is free but still held."""

from __future__ import annotations

import ctypes
from contextlib import suppress


def give_back() -> None:
    """Give freed memory back to the operating system, for programs that answer many unlike scenes.

    glibc keeps what is freed between pieces still in use, far more than these in the end. It takes some milliseconds; where the
    C library is another one, nothing is done.
    """
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
