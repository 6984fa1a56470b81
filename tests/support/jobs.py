"""A job for workers whose items state what they do: return, crash, leave, wait for ever, or raise."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class ActJob:
    """Each item is evaluated alone; ``refuses`` states that this worker cannot do the job."""

    refuses: bool = False

    def warm_up(self) -> None:
        if self.refuses:
            raise ValueError("another\nversion")

    def count_parts(self, items: Sequence[str]) -> list[int]:
        return [1] * len(items)

    def evaluate_parts(self, items: Sequence[str]) -> Iterator[list[str]]:
        for item in items:
            if item == "crash":
                os.kill(os.getpid(), signal.SIGSEGV)
            if item == "leave":
                os._exit(0)
            if item == "wait":
                time.sleep(1000)
            if item == "print":
                os.write(1, b"noise")
            yield [item.upper()]
