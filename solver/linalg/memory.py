"""What the C library does with memory that is freed. Nothing here is done by an import: the process may be another's."""

from __future__ import annotations

import ctypes
from contextlib import suppress
from functools import cache

import numpy as np


def give_back() -> None:
    """Give freed memory back to the operating system, for programs that answer many unlike scenes.

    glibc keeps what is freed between pieces still in use, far more than these in the end. It takes some milliseconds; where the
    C library is another one, nothing is done.
    """
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


@cache
def keep_freed() -> None:
    """Let arrays up to 32 MB be made of what was freed before, for programs that make many of them over and over.

    glibc does so with arrays smaller than the largest ever freed, so that one is made and freed, once a process. Without it
    a third of the time goes into new pages.
    """
    np.empty(2**22 - 2**12)
