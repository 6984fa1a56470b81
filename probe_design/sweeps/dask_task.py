"""The task that a Dask worker runs: evaluate a batch of designs in a separate process.

The process is reused for later batches. A design that crashes or takes too long ends only this process, not the Dask worker.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Sequence
from dataclasses import asdict
from time import monotonic

from geometry.common.resources import Limits
from geometry.scenes.keys import Value
from probe_design.sweeps.local_workers import WorkerProcess
from probe_design.sweeps.rows import Job
from probe_design.sweeps.workers import Outcome

MAX_IDLE_TIME_S = 60.0  # seconds without work after which a process is stopped


class _IdleProcesses:
    """Worker processes without work, each with the job and limits that it was started for."""

    def __init__(self) -> None:
        self._idle: list[tuple[float, str, WorkerProcess]] = []
        self._lock, self._is_scheduled = threading.Lock(), False

    def borrow(self, name: str) -> WorkerProcess | None:
        """Take an idle process for this job and these limits, or return None."""
        with self._lock:
            entry = next((item for item in self._idle if item[1] == name), None)
            if entry is None:
                return None
            self._idle.remove(entry)
            return entry[2]

    def give_back(self, name: str, worker: WorkerProcess) -> None:
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


def evaluate_batch(job: Job, limits: Limits, designs: Sequence[tuple[Value, ...]]) -> Outcome:
    """Evaluate a batch of designs in an idle or new worker process.

    Args:
        job: settings shared by all designs.
        limits: time and memory of each design.
        designs: values of the variables, one tuple per design.
    """
    name = json.dumps([asdict(job), asdict(limits)])
    worker = _IDLE_PROCESSES.borrow(name) or WorkerProcess(job, limits)
    outcome = worker.evaluate(designs)
    _IDLE_PROCESSES.give_back(name, worker)
    return outcome
