"""Workers on this computer: processes, and a thread here that waits for each."""

from __future__ import annotations

import queue
import threading
from dataclasses import replace
from pathlib import Path

from probe_design.sweeps.rows import Job
from probe_design.sweeps.worker_process import WorkerProcess
from probe_design.sweeps.workers import Batch, FinishedBatch, Outcome


class LocalCrew:
    """Worker processes."""

    def __init__(self, job: Job, workers: int, limit: float | None, errors: Path) -> None:
        """Make a crew; processes are started when they are needed.

        Args:
            job: what all designs share.
            workers: how many processes.
            limit: seconds that a design may take.
            errors: file for what libraries write to standard error.
        """
        self._path, self._errors = errors, errors.open("ab")
        self._answers: queue.SimpleQueue[tuple[WorkerProcess, FinishedBatch]] = queue.SimpleQueue()
        self._threads: list[threading.Thread] = []
        self._idle = [WorkerProcess(job, limit, self._errors) for _ in range(workers)]
        self._all = tuple(self._idle)

    def free(self) -> int:
        """Return how many workers have nothing to do."""
        return len(self._idle)

    def size(self) -> int:
        """Return how many workers there are."""
        return len(self._all)

    def give(self, batch: Batch) -> None:
        """Hand a batch to a free worker."""
        worker = self._idle.pop()
        thread = threading.Thread(target=lambda: self._answers.put((worker, self._answer(worker, batch))), daemon=True)
        self._threads = [one for one in self._threads if one.is_alive()] + [thread]
        thread.start()

    def take(self, seconds: float) -> list[FinishedBatch]:
        """Wait for answers, at most that long."""
        found: list[FinishedBatch] = []
        try:
            while True:
                worker, answer = self._answers.get(timeout=0 if found else seconds)
                self._idle.append(worker)
                found.append(answer)
        except queue.Empty:
            return found

    def close(self) -> None:
        """Stop all processes."""
        for worker in self._all:
            worker.close()
        for thread in self._threads:
            thread.join()
        for worker in self._all:
            worker.stop()
        self._errors.close()

    def _answer(self, worker: WorkerProcess, batch: Batch) -> FinishedBatch:
        try:
            found = worker.answer([task.values for task in batch])
        except Exception as fault:  # a thread that ends without an answer is waited for in vain
            found = Outcome(refused=f"{type(fault).__name__}: {fault}")
        if found.refused:
            found = replace(found, refused=f"{found.refused}; {self._path} may tell why")
        return FinishedBatch(batch, found)
