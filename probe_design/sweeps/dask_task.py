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
from probe_design.sweeps.keys import Value
from probe_design.sweeps.local_workers import WorkerProcess
from probe_design.sweeps.rows import Job
from probe_design.sweeps.workers import Outcome

IDLE = 60.0  # seconds without work after which a process is stopped


class _Pool:
    """Worker processes without work, each with the job and limits that it was started for."""

    def __init__(self) -> None:
        self._idle: list[tuple[float, str, WorkerProcess]] = []
        self._lock, self._watched = threading.Lock(), False

    def lent(self, name: str) -> WorkerProcess | None:
        """Take an idle process for this job and these limits, or return None."""
        with self._lock:
            entry = next((one for one in self._idle if one[1] == name), None)
            if entry is None:
                return None
            self._idle.remove(entry)
            return entry[2]

    def back(self, name: str, worker: WorkerProcess) -> None:
        """Keep a process for the next batch."""
        with self._lock:
            self._idle.append((monotonic(), name, worker))
            self._watch()

    def _watch(self) -> None:
        """Check for idle processes later, as long as there are any."""
        if self._idle and not self._watched:
            self._watched = True
            timer = threading.Timer(IDLE, self._retire)
            timer.daemon = True
            timer.start()

    def _retire(self) -> None:
        """Stop processes that have been idle for long."""
        with self._lock:
            old = [one for one in self._idle if monotonic() - one[0] >= 0.9 * IDLE]
            self._idle, self._watched = [one for one in self._idle if one not in old], False
            self._watch()
        for _, _, worker in old:
            worker.stop()


_POOL = _Pool()


def answered(job: Job, limits: Limits, designs: Sequence[tuple[Value, ...]]) -> Outcome:
    """Evaluate a batch of designs in an idle or new worker process.

    Args:
        job: settings shared by all designs.
        limits: time and memory of each design.
        designs: values of the variables, one tuple per design.
    """
    name = json.dumps([asdict(job), asdict(limits)])
    worker = _POOL.lent(name) or WorkerProcess(job, limits)
    outcome = worker.answer(designs)
    _POOL.back(name, worker)
    return outcome
