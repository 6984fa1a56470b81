"""Evaluate batches on this computer, in processes with one waiting thread for each.

A process that has ended is replaced by a new one, so that a crash or a time limit costs only the item that caused it.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import replace
from itertools import accumulate, count
from pathlib import Path
from typing import IO, Generic

from geometry.common.resources import Limits
from geometry.processes.child import END, Child, Died, Failure, TooLong
from geometry.processes.executor import Item, Job, Outcome, Row

POOL_PROGRAM = Path(__file__).with_name("pool_program.py")
GRACE_PERIOD_S = 5.0  # seconds for a worker to report by itself that its time is over
MAX_STARTS = 3  # attempts to start a process


class LocalExecutor(Generic[Item, Row]):
    """Worker processes; see ``executor.Executor``."""

    def __init__(self, job: Job[Item, Row], workers: int, limits: Limits, errors: Path) -> None:
        """Make the workers, whose processes are started when they are needed.

        Parameters
        ----------
        job : Job
            What is done with all items.
        workers : int
            Number of processes.
        limits : Limits
            Time and memory of each item.
        errors : Path
            File for the standard error of the processes.
        """
        self._errors = errors.open("ab")
        self._workers = [Worker(job, limits, self._errors) for _ in range(workers)]
        self._idle = [*self._workers]
        self._threads, self._numbers = ThreadPoolExecutor(workers), count()
        self._running: dict[Future[Outcome[Row]], tuple[int, Worker[Item, Row]]] = {}

    def count_free(self) -> int:
        """Return the number of idle workers."""
        return len(self._idle)

    def count_workers(self) -> int:
        """Return the number of workers."""
        return len(self._workers)

    def submit(self, items: Sequence[Item]) -> int:
        """Give a batch to an idle worker, and return the batch's number; ``count_free`` has to be above 0."""
        worker, number = self._idle.pop(), next(self._numbers)
        self._running[self._threads.submit(worker.evaluate, items)] = number, worker
        return number

    def collect(self, seconds: float) -> list[tuple[int, Outcome[Row]]]:
        """Return the batches finished within ``seconds``, by number; see ``executor.Executor.collect``."""
        finished = []
        for future in wait(self._running, seconds, FIRST_COMPLETED).done:
            number, worker = self._running.pop(future)
            self._idle.append(worker)
            fault = future.exception()
            outcome = future.result() if fault is None else Outcome(refusal=f"{type(fault).__name__}: {fault}")
            if outcome.refusal:
                outcome = replace(outcome, refusal=f"{outcome.refusal}; see {self._errors.name}")
            finished.append((number, outcome))
        return finished

    def close(self) -> None:
        """Stop all processes."""
        for worker in self._workers:
            worker.close()
        self._threads.shutdown()  # waits for the threads, which go on now that their processes are dead
        for worker in self._workers:
            worker.stop()
        self._errors.close()


class Worker(Generic[Item, Row]):
    """A process that does a job; started when it is needed, and again after it has ended."""

    def __init__(self, job: Job[Item, Row], limits: Limits, errors: IO[bytes] | int) -> None:
        """Store the settings; the process is started later.

        Parameters
        ----------
        job : Job
            What is done with all items.
        limits : Limits
            Time and memory of each item.
        errors : IO or int
            File, or its descriptor, for the standard error of the process.
        """
        self._job, self._limits, self._errors = job, limits, errors
        self._child: Child | None = None
        self._is_closed = False

    def evaluate(self, items: Sequence[Item]) -> Outcome[Row]:
        """Return the outcome of items that the process evaluates, started first if it is not running.

        A time limit, a crash or a refusal are not raised, but described in the outcome.
        """
        try:
            child = self._child or self._start()
        except (Died, OSError):
            return Outcome(refusal="no worker process starts")
        except Failure as fault:
            return Outcome(refusal=str(fault))
        if self._is_closed:
            return Outcome()
        rows: list[Row] = []
        # numbers of rows after each part; number of items that are evaluated now, which a crash leaves unfinished
        ends, begun = [*accumulate(self._job.count_parts(items))], 0
        try:
            child.send((self._job, self._limits, items))
            while not child.is_late:  # a part may come at the last moment: the process is gone, but no item is to blame
                begun = _count_begun(ends, len(rows))
                with child.limit_time(begun * self._limits.seconds + min(GRACE_PERIOD_S, self._limits.seconds)):
                    part = child.receive()
                if part is END:
                    return Outcome(tuple(rows))
                rows += part
        except TooLong:
            return Outcome(tuple(rows), begun, is_late=True)
        except Died as fault:
            return Outcome(tuple(rows), begun, f"{fault}: out of memory, a crash of a library, or ended from outside")
        except Failure as fault:
            return Outcome(tuple(rows), refusal=str(fault))
        finally:
            if not child.is_alive:
                self.stop()
        return Outcome(tuple(rows))

    def kill(self) -> None:
        """Kill the process; a thread that waits for it goes on."""
        if (child := self._child) is not None:
            child.kill()

    def stop(self) -> None:
        """Kill the process and remove its files; call ``close`` and join waiting threads first."""
        child, self._child = self._child, None
        if child is not None:
            child.close()

    def close(self) -> None:
        """Kill the process and accept no more work."""
        self._is_closed = True
        self.kill()

    def _start(self) -> Child:
        """Start a process, and get it ready for the job. Raises ``Failure``, ``Died`` where it ends ``MAX_STARTS`` times."""
        for attempt in range(MAX_STARTS):
            self._child = Child(POOL_PROGRAM, errors=self._errors, is_worker=True)
            try:
                self._child.send((self._job, self._limits, None))  # no items: get ready
                self._child.receive()
                return self._child
            except Failure as fault:
                self.stop()
                if not isinstance(fault, Died) or self._is_closed or attempt + 1 == MAX_STARTS:
                    raise
        raise AssertionError  # never reached, as MAX_STARTS is positive


def _count_begun(ends: Sequence[int], rows: int) -> int:
    """Return how many items a worker evaluates at once after the first ``rows``; 0 after the last.

    Parts end at ``ends``. A part whose rows come one by one is evaluated one by one.
    """
    if rows == ends[-1]:
        return 0
    return ends[bisect(ends, rows)] - rows if rows in (0, *ends) else 1
