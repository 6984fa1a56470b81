"""Give the designs of a sweep to an executor in batches, and commit their rows, even if workers die meanwhile."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from time import monotonic

from geometry.processes.executor import Executor, ExecutorError, Outcome
from probe_design.sweeps.progress import Progress, ReportProgress
from probe_design.sweeps.rows import FORMULA_EVALUATOR, MAX_CURVE_DESIGNS, Design, Job, Row, build_row_without_result
from probe_design.sweeps.store import Store

BATCH_TIME_S = 0.5  # of work in a batch: some hundred times the cost of submitting it; a kill may lose it
MAX_BATCH_DESIGNS = 2000  # designs in a batch, at most
MAX_WORKER_DEATHS = 2  # workers that may die with a design alone in its batch before it counts as failed
Log = Callable[[str], None]


@dataclass(frozen=True)
class Task:
    """A design to be evaluated.

    Attributes
    ----------
    key
        Key of its row in the store.
    values
        Values of the variables.
    count
        Number of identical designs.
    deaths
        Number of workers that died with it.
    group
        Number of a group that is evaluated together, in one batch; None where any designs can be.
    """

    key: bytes
    values: Design
    count: int = 1
    deaths: int = 0
    group: int | None = None


Batch = tuple[Task, ...]


class BatchRun:
    """One run of a sweep: gives batches to the executor and commits their rows."""

    def __init__(
        self,
        store: Store,
        executor: Executor[Design, Row],
        reporters: Sequence[ReportProgress],
        log: Log,
        *,
        total: int,
        seconds: float,
    ) -> None:
        """Prepare a run.

        Parameters
        ----------
        store
            Takes the rows.
        executor
            Evaluates designs.
        reporters
            Called with the progress after each batch.
        log
            Called with a line for each worker that ended.
        total
            Number of designs of the sweep.
        seconds
            Time limit of a design, s.
        """
        self._store, self._executor, self._reporters, self._log = store, executor, reporters, log
        self._total, self._seconds = total, seconds
        self._start_time, self._counts = monotonic(), store.count_rows()
        self._initial_count = sum(self._counts.values())
        self._cost = BATCH_TIME_S  # seconds per row, as measured; the first batch is one design
        self._batches: dict[int, Batch] = {}  # that workers have, by the executor's numbers

    def process_tasks(self, tasks: list[Task]) -> None:
        """Evaluate all tasks; return when each has a row."""
        waiting, alone = deque(tasks), deque[Task]()  # alone: tasks that a worker died with, one in a batch
        self._report()
        while waiting or alone or self._batches:
            while (waiting or alone) and self._executor.count_free() > 0:
                batch = (alone.popleft(),) if alone else self._take_batch(waiting)
                self._batches[self._executor.submit([task.values for task in batch])] = batch
            finished = self._executor.collect(1.0)  # waits at most 1 s
            self._store.check_file()
            for number, outcome in finished:
                unstarted, suspects = self._store_outcome(self._batches.pop(number), outcome)
                waiting.extendleft(reversed(unstarted))
                alone.extend(suspects)
            self._report()

    def _take_batch(self, waiting: deque[Task]) -> Batch:
        """Take the next batch: ``BATCH_TIME_S`` of work, less at the end so that all workers end together; groups stay whole."""
        fair_count = len(waiting) / (2 * max(1, self._executor.count_workers()))
        count = max(1, min(int(BATCH_TIME_S / self._cost), MAX_BATCH_DESIGNS, int(fair_count)))
        batch = [waiting.popleft() for _ in range(min(count, len(waiting)))]
        while waiting and waiting[0].group is not None and waiting[0].group == batch[-1].group:
            batch.append(waiting.popleft())
        return tuple(batch)

    def _store_outcome(self, batch: Batch, outcome: Outcome[Row]) -> tuple[list[Task], list[Task]]:
        """Commit the rows of a batch; return its tasks that were not started, and those to be tried again, each alone."""
        count = len(outcome.rows)
        if outcome.refusal:
            raise ExecutorError(outcome.refusal)
        if count:
            self._commit(batch[:count], outcome.rows)
            cost = sum(row["seconds"] for row in outcome.rows) / count
            self._cost = max(0.5 * (self._cost + cost), 1e-6)  # mean of old and new, so that it follows changes; not 0
        begun, unstarted = batch[: count + outcome.unfinished], batch[count + outcome.unfinished :]
        retries = self._retry_held(begun[count:], outcome) if outcome.unfinished else []
        # the rest of a group whose first designs were evaluated one by one
        interrupted = [task for task in unstarted if begun and None is not task.group == begun[-1].group]
        return list(unstarted[len(interrupted) :]), [*retries, *interrupted]

    def _retry_held(self, tasks: Batch, outcome: Outcome[Row]) -> list[Task]:
        """Return which tasks of a worker that ended are to be tried again, each alone.

        A single task that was late, or with which ``MAX_WORKER_DEATHS`` workers died, gets a row instead.
        """
        reason = f"longer than {self._seconds:g} s" if outcome.is_late else outcome.failure
        self._log(f"a worker ended with {len(tasks)} designs: {reason}")
        if len(tasks) > 1:
            return list(tasks)
        task = tasks[0]
        if outcome.is_late:
            row = build_row_without_result("failed", "TimeLimit", f"took {reason}", self._seconds) | {"time_limit": self._seconds}
        elif task.deaths + 1 < MAX_WORKER_DEATHS:
            return [replace(task, deaths=task.deaths + 1)]
        else:
            row = build_row_without_result("failed", "WorkerDied", f"{MAX_WORKER_DEATHS} times in a row, {outcome.failure}", 0.0)
        self._commit(tasks, [row])
        return []

    def _commit(self, batch: Batch, rows: Sequence[Row]) -> None:
        """Commit rows and count them by status."""
        self._store.add([(task.key, row) for task, row in zip(batch, rows, strict=True)])
        for task, row in zip(batch, rows, strict=True):
            self._counts[row["status"]] += task.count

    def _report(self) -> None:
        """Report the progress."""
        done = sum(self._counts.values())
        rate = (done - self._initial_count) / max(monotonic() - self._start_time, 1e-9)
        counts = (self._counts["refused"], self._counts["failed"])
        state = Progress(self._total, done, *counts, rate, self._executor.count_workers())
        for report in self._reporters:
            report(state)


def order_tasks(job: Job, tasks: list[Task]) -> list[Task]:
    """Return the tasks with those that can be evaluated together next to each other, and numbered as groups.

    The order is kept otherwise; the closed form evaluates any designs together and needs no groups.
    """
    if job.evaluator == FORMULA_EVALUATOR:
        return tasks
    groups: dict[Hashable, list[Task]] = defaultdict(list)
    for task, group_key in zip(tasks, job.group_designs([task.values for task in tasks]), strict=True):
        groups[group_key].append(task)
    parts = [
        group[first : first + MAX_CURVE_DESIGNS] for group in groups.values() for first in range(0, len(group), MAX_CURVE_DESIGNS)
    ]
    return [replace(task, group=number) for number, part in enumerate(parts) for task in part]
