"""What the C library does with memory that is freed. Nothing here is done by an import: the process may be another's."""

from __future__ import annotations

import ctypes
import os
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np


class _Heap(ctypes.Structure):
    """What glibc's ``mallinfo2`` tells of the heap, in bytes; ``uordblks`` and ``hblkhd``: pieces in use."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in ("arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost")
    )


class _Freed:
    """The heap of this process: how many bytes its pages had beside pieces in use, when they last were given back."""

    left = 0

    def give_back(self, worth: float) -> None:
        library = ctypes.CDLL(None)
        library.mallinfo2.restype = _Heap
        idle = _idle(library)
        self.left = min(self.left, idle)
        if idle - self.left >= worth:
            library.malloc_trim(0)
            self.left = _idle(library)


def _idle(library: ctypes.CDLL) -> int:
    """Bytes of the process that are not the heap's pieces in use: glibc does not tell which of its free pieces have pages."""
    heap = library.mallinfo2()
    resident = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return resident - int(heap.uordblks) - int(heap.hblkhd)


_FREED = _Freed()


def give_back(worth: float = 0.0) -> None:
    """Give freed memory back to the operating system if it is ``worth`` bytes, for programs that answer many unlike scenes.

    glibc keeps what is freed between pieces still in use, far more than these in the end. It takes some milliseconds; where the
    C library is another one, or older than 2.33, nothing is done.
    """
    with suppress(AttributeError, OSError, TypeError):
        _FREED.give_back(worth)


@cache
def keep_freed() -> None:
    """Let arrays up to 32 MB be made of what was freed before, for programs that make many of them over and over.

    glibc does so with arrays smaller than the largest ever freed, so that one is made and freed, once a process. Without it
    a third of the time goes into new pages.
    """
    np.empty(2**22 - 2**12)
