"""What a Dask worker runs: batches of a sweep, by worker processes that it keeps for a while.

A process for each batch at a time, as on one computer: a design that crashes or takes too long leaves the Dask worker alone.
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

IDLE = 60.0  # seconds after which a process without work is ended


class _Pool:
    """Processes without work, by what they are for."""

    def __init__(self) -> None:
        self._idle: list[tuple[float, str, WorkerProcess]] = []
        self._lock, self._watched = threading.Lock(), False

    def lent(self, name: str) -> WorkerProcess | None:
        with self._lock:
            entry = next((one for one in self._idle if one[1] == name), None)
            if entry is None:
                return None
            self._idle.remove(entry)
            return entry[2]

    def back(self, name: str, worker: WorkerProcess) -> None:
        with self._lock:
            self._idle.append((monotonic(), name, worker))
            self._watch()

    def _watch(self) -> None:
        """Look for old ones later, as long as there are any."""
        if self._idle and not self._watched:
            self._watched = True
            timer = threading.Timer(IDLE, self._retire)
            timer.daemon = True
            timer.start()

    def _retire(self) -> None:
        with self._lock:
            old = [one for one in self._idle if monotonic() - one[0] >= 0.9 * IDLE]
            self._idle, self._watched = [one for one in self._idle if one not in old], False
            self._watch()
        for _, _, worker in old:
            worker.stop()


_POOL = _Pool()


def answered(job: Job, limits: Limits, designs: Sequence[tuple[Value, ...]]) -> Outcome:
    """Answer a batch.

    Args:
        job: what all designs share.
        limits: of each design.
        designs: values of the variables.
    """
    name = json.dumps([asdict(job), asdict(limits)])
    worker = _POOL.lent(name) or WorkerProcess(job, limits)
    outcome = worker.answer(designs)
    _POOL.back(name, worker)
    return outcome
