"""Evaluate a batch in a separate process: the task that a Dask worker runs.

The process is reused for later batches. An item that crashes or takes too long ends only this process, not the Dask worker.
"""

from __future__ import annotations

import pickle
import threading
from collections.abc import Sequence
from time import monotonic
from typing import Any

from geometry.common.resources import Limits
from geometry.processes.executor import Item, Job, Outcome, Row
from geometry.processes.local_executor import Worker

_STANDARD_ERROR = 2  # its file descriptor
MAX_IDLE_TIME_S = 60.0  # seconds without work after which a process is stopped


class _IdleProcesses:
    """Worker processes without work, each with the job and limits that it was started for."""

    def __init__(self) -> None:
        self._idle: list[tuple[float, bytes, Worker[Any, Any]]] = []
        self._lock, self._is_scheduled = threading.Lock(), False

    def borrow(self, name: bytes) -> Worker[Any, Any] | None:
        """Take an idle process for this job and these limits, or return None."""
        with self._lock:
            entry = next((item for item in self._idle if item[1] == name), None)
            if entry is None:
                return None
            self._idle.remove(entry)
            return entry[2]

    def give_back(self, name: bytes, worker: Worker[Any, Any]) -> None:
        """Keep a process for the next batch."""
        with self._lock:
            self._idle.append((monotonic(), name, worker))
            self._schedule_check()

    def _schedule_check(self) -> None:
        """Check for idle processes later, as long as there are any."""
        if self._idle and not self._is_scheduled:
            self._is_scheduled = True
            timer = threading.Timer(MAX_IDLE_TIME_S, self._stop_old)
            timer.daemon = True
            timer.start()

    def _stop_old(self) -> None:
        """Stop processes that have been idle for long."""
        with self._lock:
            old = [item for item in self._idle if monotonic() - item[0] >= 0.9 * MAX_IDLE_TIME_S]
            self._idle, self._is_scheduled = [item for item in self._idle if item not in old], False
            self._schedule_check()
        for _, _, worker in old:
            worker.stop()


_IDLE_PROCESSES = _IdleProcesses()


def evaluate_batch(job: Job[Item, Row], limits: Limits, items: Sequence[Item]) -> Outcome[Row]:
    """Evaluate a batch in an idle or new worker process.

    Parameters
    ----------
    job : Job
        What is done with all items.
    limits : Limits
        Time and memory of each item.
    items : sequence
        The batch.
    """
    name = pickle.dumps((job, limits))
    worker = _IDLE_PROCESSES.borrow(name) or Worker(job, limits, _STANDARD_ERROR)
    outcome = worker.evaluate(items)
    _IDLE_PROCESSES.give_back(name, worker)
    return outcome
