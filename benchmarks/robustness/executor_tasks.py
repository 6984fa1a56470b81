"""Tasks for ``executors.py``, in a module of their own that processes can import: sound ones, and ones at fault."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

MEMORY_BYTES = 600_000_000  # of each process: RLIMIT_DATA
ENDLESS_S = 123.0  # s: longer than any trial


def limit_memory() -> None:
    """Limit the memory of a process that begins."""
    import resource

    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))


def square(fault: str) -> object:
    """Return 36, or be at fault."""
    return 36 if not fault else FAULTS[fault].act()


def crash() -> None:
    """End as a library that reads memory that is not its own."""
    os.kill(os.getpid(), signal.SIGSEGV)


def leave() -> None:
    """End as a library that calls exit."""
    os._exit(0)


def run_endlessly() -> None:
    """Compute without an end, together with a process of its own."""
    subprocess.run([sys.executable, "-c", f"import time; time.sleep({ENDLESS_S})"], check=False)


def allocate() -> int:
    """Take more memory than allowed."""
    return len(bytearray(2 * MEMORY_BYTES))


def return_function() -> object:
    """Return what no pickle can hold."""
    return lambda: 0


def print_noise() -> int:
    """Print to standard output, past Python."""
    os.write(1, b"noise\n")
    return 36


@dataclass(frozen=True)
class Fault:
    """What one of the tasks does, and what its outcome has to name."""

    act: Callable[[], object]
    reason: str


FAULTS = {
    "segmentation fault": Fault(crash, "SIGSEGV|signal 11|-11"),
    "os._exit": Fault(leave, "code 0|exit"),
    "endless": Fault(run_endlessly, "too long|longer|late|TimeoutError"),
    "memory": Fault(allocate, "memory|MemoryError"),
    "unpicklable": Fault(return_function, "pickle"),
    "stdout noise": Fault(print_noise, "36"),
}


@dataclass(frozen=True)
class SquareJob:
    """The job of this project's workers."""

    memory: bool

    def warm_up(self) -> None:
        """Limit memory."""
        if self.memory:
            limit_memory()

    def count_parts(self, items: Sequence[str]) -> list[int]:
        """Each alone."""
        return [1] * len(items)

    def evaluate_parts(self, items: Sequence[str]) -> Iterator[list[object]]:
        """Yield the results."""
        for fault in items:
            yield [square(fault)]
