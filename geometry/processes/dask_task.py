"""Evaluate a batch in a separate process: the task that a Dask worker runs.

The process is reused for later batches. An item that crashes or takes too long ends only this process, not the Dask worker.
"""

from __future__ import annotations

import pickle
import threading
from collections.abc import Sequence
from typing import Any

from geometry.common.resources import Limits
from geometry.processes.executor import Item, Job, Outcome, Row
from geometry.processes.local_executor import Worker

_STANDARD_ERROR = 2  # its file descriptor
MAX_IDLE_TIME_S = 60.0  # seconds without work after which a process is stopped
_IDLE_WORKERS: dict[Worker[Any, Any], tuple[bytes, threading.Timer]] = {}  # each with its job and limits, and its end
_LOCK = threading.Lock()  # of the idle workers: a Dask worker may have several threads


def evaluate_batch(job: Job[Item, Row], limits: Limits, items: Sequence[Item]) -> Outcome[Row]:
    """Return the outcome of a batch, evaluated in an idle or a new worker process.

    Parameters
    ----------
    job : Job
        What is done with all items.
    limits : Limits
        Time and memory of each item.
    items : sequence
        The batch.
    """
    name = pickle.dumps((job, limits))  # equal for equal jobs and limits, so that their processes can be reused
    worker = _take_idle_worker(name) or Worker(job, limits, _STANDARD_ERROR)
    outcome = worker.evaluate(items)
    timer = threading.Timer(MAX_IDLE_TIME_S, _stop_idle_worker, (worker,))
    timer.daemon = True
    with _LOCK:
        _IDLE_WORKERS[worker] = name, timer
    timer.start()
    return outcome


def _take_idle_worker(name: bytes) -> Worker[Any, Any] | None:
    """Take an idle worker with this job and these limits, or return None."""
    with _LOCK:
        for worker, (idle_name, timer) in _IDLE_WORKERS.items():
            if idle_name == name:
                timer.cancel()
                del _IDLE_WORKERS[worker]
                return worker
    return None


def _stop_idle_worker(worker: Worker[Any, Any]) -> None:
    """Stop a worker process unless it was given work since its timer was started."""
    with _LOCK:
        is_idle = _IDLE_WORKERS.pop(worker, None) is not None
    if is_idle:
        worker.stop()
