"""Control how the C library reuses freed memory. An import changes nothing: the process may belong to others."""

from __future__ import annotations

import ctypes
import os
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np


class _Heap(ctypes.Structure):
    """The result of glibc's ``mallinfo2``, in bytes; ``uordblks`` and ``hblkhd`` are the pieces in use."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in ("arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost")
    )


class _FreedMemory:
    """Freed memory of this process: how many bytes were idle when memory was last given back."""

    idle_bytes = 0

    def give_back(self, worth: float) -> None:
        """Return freed memory to the system if it grew by ``worth`` bytes or more since it was last returned."""
        library = ctypes.CDLL(None)
        library.mallinfo2.restype = _Heap
        idle = _measure_idle_bytes(library)
        self.idle_bytes = min(self.idle_bytes, idle)
        if idle - self.idle_bytes >= worth:
            library.malloc_trim(0)
            self.idle_bytes = _measure_idle_bytes(library)


def _measure_idle_bytes(library: ctypes.CDLL) -> int:
    """Return the resident bytes of the process minus the heap's pieces in use: an estimate of its free pieces.

    glibc does not report how many of the free pieces are resident.
    """
    heap = library.mallinfo2()
    resident = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return resident - int(heap.uordblks) - int(heap.hblkhd)


_FREED_MEMORY = _FreedMemory()


def give_back(worth: float = 0.0) -> None:
    """Return freed memory to the operating system if it is at least ``worth`` bytes.

    glibc keeps memory that is freed between pieces in use. In programs that evaluate many different scenes that becomes far more
    than the pieces themselves. The call takes some milliseconds. Where the C library is another one, or older than 2.33, nothing
    is done.
    """
    with suppress(AttributeError, OSError, TypeError):
        _FREED_MEMORY.give_back(worth)


@cache
def keep_freed() -> None:
    """Let arrays up to 32 MB reuse freed memory, for programs that make many of them again and again.

    glibc does so with arrays smaller than the largest ever freed. So one such array is made and freed, once in each process.
    Without it a third of the time goes into new pages.
    """
    np.empty(2**22 - 2**12)  # numbers of 8 bytes: just below 32 MB, the largest size for which glibc does so
