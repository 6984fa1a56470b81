"""Run a sweep: evaluate in batches every design that has no row in the store yet, even if workers die meanwhile."""

from __future__ import annotations

import hashlib
import json
import os
from collections import defaultdict, deque
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from geometry.common.errors import InputError
from geometry.common.files import write_text
from geometry.common.resources import Limits
from geometry.processes.executor import Executor, ExecutorError, Outcome
from geometry.processes.local_executor import LocalExecutor
from geometry.provenance.block import build_provenance
from geometry.scenes.scene import Scene
from geometry.scenes.units import SI_CONTEXT
from probe_design.sweeps.file import Sweep, read_sweep, sweep_from_dict
from probe_design.sweeps.progress import Progress, Tell, open_log
from probe_design.sweeps.rows import MAX_CURVE_DESIGNS, Design, Job, Row, build_unanswered_row
from probe_design.sweeps.store import Store, StoreError, open_for_writing
from probe_design.sweeps.variables import check_integer
from solver.results.record import Record

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

BATCH_TIME_S = 0.5  # of work in a batch: some hundred times the cost of submitting it; a kill may lose it
MAX_BATCH_DESIGNS = 2000  # designs in a batch, at most
Log = Callable[[str], None]
PROVENANCE_FILE = "provenance.json"
FORMULA_EVALUATOR = "closed-form"
MAX_WORKER_DEATHS = 2  # workers that may die with a design alone in its batch before it counts as failed


@dataclass(frozen=True)
class SweepSummary(Record):
    """A finished sweep.

    Attributes:
        folder: of its store.
        designs: number of designs, each with a row.
        left_out: number of designs that do not satisfy the constraints; they have no row.
        ok, refused, failed: number of rows by status.
        answered: number of rows that this run added.
        seconds: wall clock of this run.
    """

    folder: Path
    designs: int
    left_out: int
    ok: int
    refused: int
    failed: int
    answered: int
    seconds: float

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``probe-design sweep``."""
        return super().as_dict() | {"folder": str(self.folder)}

    def dataframe(self) -> pd.DataFrame:
        """Return all rows; see ``probe_design.sweeps.results.dataframe``."""
        from probe_design.sweeps.results import dataframe

        return dataframe(self.folder)

    def to_dataset(self) -> xr.Dataset:
        """Return all rows with labels and units; the same as ``dataset``."""
        return self.dataset()

    def dataset(self) -> xr.Dataset:
        """Return all rows with labels and units; see ``probe_design.sweeps.results.dataset``."""
        from probe_design.sweeps.results import dataset

        return dataset(self.folder)


def sweep(
    specification: Sweep | Mapping[str, Any] | Path | str,
    output: Path | str,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Tell | None = None,
    retry_failed: bool = False,
    notice: Log | None = None,
) -> SweepSummary:
    """Evaluate every design of a sweep that has no row in ``output`` yet.

    Args:
        specification: the name of a sweep file, or its tables; numbers are then in SI units and ``scene`` may be a ``Scene``.
        output: folder of the store.
        scheduler: address of a Dask scheduler, ``tcp://host:8786``; by default processes on this computer are used.
        workers: number of processes; by default one for each processor.
        progress: called with a ``Progress`` after each batch.
        retry_failed: whether designs whose row is ``failed`` are evaluated again; the new row replaces the old one. Designs that
            were stopped, or kept from a finer result, by a limit that is larger now are always evaluated again.
        notice: called with a line when the sweep has to wait, such as for a Dask scheduler that does not respond.

    Raises:
        InputError: the specification is not valid, or another process is writing to the folder.
        StoreError: the store cannot be read or written, or is moved or deleted meanwhile. Committed rows are kept.
        ExecutorError: workers do not start, have another version of this program, or the scheduler is lost for good.
            Committed rows are kept.
        KeyboardInterrupt: committed rows are kept.
    """
    start = monotonic()
    checked_sweep = specification if isinstance(specification, Sweep) else _read_specification(specification)
    if workers is not None:
        check_integer("workers", workers, 1, 1024)
    if workers is not None and scheduler is not None:
        raise InputError("workers", workers, "none with a scheduler, which has its own")
    folder = Path(output)
    with open_for_writing(folder) as store, open_log(folder, progress) as (tell, log):
        job = Job.from_sweep(checked_sweep)
        log_notice = log if notice is None else _combine_logs(log, notice)
        if store.repair_note:
            log_notice(store.repair_note)
        total, left_out = _begin(store, checked_sweep, job)
        if forgotten := store.forget_limited(checked_sweep.limits):
            log(f"forgets {forgotten} rows that smaller limits stopped, or kept from a finer result")
        if retry_failed:
            log(f"forgets {store.forget('failed')} failed rows")
        tasks = _order_tasks(job, [Task(key, values, count) for count, values, key in store.find_missing()])
        log(f"begins: {total} designs, {len(tasks)} to be evaluated, version {job.version}")
        if tasks:
            processes = min(workers or _count_processors(), len(tasks))
            with _open_executor(
                job, scheduler, processes, limits=checked_sweep.limits, folder=folder, log=log_notice
            ) as executor:
                _SweepRun(store, executor, tell, log, total=total, seconds=checked_sweep.limits.seconds).process_tasks(tasks)
        counts = store.count_rows()
        if sum(counts.values()) != total:
            raise StoreError(f"{folder}: the store has {sum(counts.values())} rows of {total} designs: start again")
        log(f"ends: {counts}")
    summary = SweepSummary(folder, total, left_out, **counts, answered=len(tasks), seconds=monotonic() - start)
    _write_provenance(summary, checked_sweep)
    return summary


def _write_provenance(summary: SweepSummary, sweep: Sweep) -> None:
    """Write the counts and the provenance of the rows to ``provenance.json`` in the folder of the sweep."""
    scene = Scene.model_validate(sweep.base, context=SI_CONTEXT)
    origin = build_provenance(scene, evaluator=sweep.evaluator, accuracy=sweep.accuracy, seed=sweep.sample.seed)
    counts = {name: getattr(summary, name) for name in ("designs", "left_out", "ok", "refused", "failed")}
    write_text(summary.folder / PROVENANCE_FILE, json.dumps(counts | {"provenance": origin}, indent=2) + "\n")


def _combine_logs(log: Log, notice: Log) -> Log:
    """Return a function that logs a line and passes it to the user."""

    def log_both(text: str) -> None:
        log(text)
        notice(text)

    return log_both


@dataclass(frozen=True)
class Task:
    """A design to be evaluated.

    Attributes:
        key: of its row.
        values: of the variables.
        count: number of identical designs.
        deaths: number of workers that died with it.
        group: number of a group that is evaluated together, in one batch; None where any designs can be.
    """

    key: bytes
    values: Design
    count: int = 1
    deaths: int = 0
    group: int | None = None


Batch = tuple[Task, ...]


class _SweepRun:
    """One run of a sweep: gives batches to the executor and commits their rows."""

    def __init__(
        self, store: Store, executor: Executor[Design, Row], tell: Tell, log: Log, *, total: int, seconds: float
    ) -> None:
        self._store, self._executor, self._tell, self._log, self._total, self._seconds = (
            store,
            executor,
            tell,
            log,
            total,
            seconds,
        )
        self._start_time, self._counts = monotonic(), store.count_rows()
        self._initial_count = sum(self._counts.values())
        self._cost = BATCH_TIME_S  # seconds per row, as measured; the first batch is one design
        self._batches: dict[int, Batch] = {}  # that workers have, by the executor's numbers

    def process_tasks(self, tasks: list[Task]) -> None:
        """Evaluate all tasks; return when each has a row."""
        waiting, alone = deque(tasks), deque[Task]()
        self._report()
        while waiting or alone or self._batches:
            while (waiting or alone) and self._executor.count_free() > 0:
                batch = (alone.popleft(),) if alone else self._take_batch(waiting)
                self._batches[self._executor.submit([task.values for task in batch])] = batch
            finished = self._executor.collect(1.0)
            self._store.check_file()
            for number, outcome in finished:
                unstarted, suspects = self._store_outcome(self._batches.pop(number), outcome)
                waiting.extendleft(reversed(unstarted))
                alone.extend(suspects)
            self._report()

    def _take_batch(self, waiting: deque[Task]) -> Batch:
        """Take the next batch: half a second of work, less at the end so that all workers end together; groups stay whole."""
        share = len(waiting) / (2 * max(1, self._executor.count_workers()))
        count = max(1, min(int(BATCH_TIME_S / self._cost), MAX_BATCH_DESIGNS, int(share)))
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
            self._cost = max(0.5 * (self._cost + cost), 1e-6)
        begun, unstarted = batch[: count + outcome.unfinished], batch[count + outcome.unfinished :]
        retries = self._retry_held(begun[count:], outcome) if outcome.unfinished else []
        # the rest of a group whose first designs were evaluated one by one
        interrupted = [task for task in unstarted if begun and None is not task.group == begun[-1].group]
        return list(unstarted[len(interrupted) :]), [*retries, *interrupted]

    def _retry_held(self, tasks: Batch, outcome: Outcome[Row]) -> list[Task]:
        """Return the tasks to be tried again, each alone, after a worker ended with them; a design that ended it gets a row."""
        reason = f"longer than {self._seconds:g} s" if outcome.is_late else outcome.failure
        self._log(f"a worker ended with {len(tasks)} designs: {reason}")
        if len(tasks) > 1:
            return list(tasks)
        task = tasks[0]
        if outcome.is_late:
            row = build_unanswered_row("failed", "TimeLimit", f"took {reason}", self._seconds) | {"time_limit": self._seconds}
        elif task.deaths + 1 < MAX_WORKER_DEATHS:
            return [replace(task, deaths=task.deaths + 1)]
        else:
            row = build_unanswered_row("failed", "WorkerDied", f"{MAX_WORKER_DEATHS} times in a row, {outcome.failure}", 0.0)
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
        self._tell(Progress(self._total, done, *counts, rate, self._executor.count_workers()))


def _order_tasks(job: Job, tasks: list[Task]) -> list[Task]:
    """Return tasks by number, but with those that can be evaluated together next to each other; the closed form takes any."""
    if job.evaluator == FORMULA_EVALUATOR:
        return tasks
    groups: dict[Hashable, list[Task]] = defaultdict(list)
    for task, group_key in zip(tasks, job.group_designs([task.values for task in tasks]), strict=True):
        groups[group_key].append(task)
    parts = [
        group[first : first + MAX_CURVE_DESIGNS] for group in groups.values() for first in range(0, len(group), MAX_CURVE_DESIGNS)
    ]
    return [replace(task, group=number) for number, part in enumerate(parts) for task in part]


def _read_specification(specification: Mapping[str, Any] | Path | str) -> Sweep:
    return sweep_from_dict(specification) if isinstance(specification, Mapping) else read_sweep(specification)


def _begin(store: Store, sweep: Sweep, job: Job) -> tuple[int, int]:
    """Store request and designs unless they are stored already; return the numbers of designs and of excluded ones."""
    drawn_count = sweep.sample.count_designs(sweep.variables)
    digest = hashlib.sha256(repr((replace(sweep, limits=Limits()), job)).encode() + _digest_surfaces(sweep, job)).hexdigest()
    request = store.read_request()
    if request.get("digest") != digest:
        keys = sweep.keys
        designs = [(number, values, job.compute_digest(keys, values)) for number, values in sweep.list_designs()]
        store.begin(_describe_request(sweep, job) | {"digest": digest, "designs": len(designs)}, designs)
        request = {"designs": len(designs)}
    return int(request["designs"]), drawn_count - int(request["designs"])


def _describe_request(sweep: Sweep, job: Job) -> dict[str, Any]:
    """Return the request of a sweep as readers of the store need it."""
    grid = sweep.sample.kind == "grid"
    variables = [
        {
            "name": variable.key.name,
            "unit": variable.key.unit,
            "shown": variable.key.display_unit,
            "values": list(variable.values) if grid else [],
            "log": variable.log,
        }
        for variable in sweep.variables
    ]
    sample = asdict(sweep.sample)
    return {**asdict(job), "variables": variables, "sample": sample, "constraints": list(sweep.constraints)}


def _digest_surfaces(sweep: Sweep, job: Job) -> bytes:
    """Return a digest of the base scene with its surface files; empty if it has none."""
    return job.compute_digest((), ()) if any(body.get("surface") for body in sweep.base.get("inclusion", ())) else b""


@contextmanager
def _open_executor(
    job: Job, scheduler: str | None, workers: int, *, limits: Limits, folder: Path, log: Log
) -> Iterator[Executor[Design, Row]]:
    """Open the executor on a Dask cluster or this computer, and close it at the end."""
    executor: Executor[Design, Row]
    if scheduler is None:
        executor = LocalExecutor(job, workers, limits, folder / "workers.log")
    else:
        from geometry.processes.dask_executor import DaskExecutor

        executor = DaskExecutor(job, scheduler, limits, log)
    try:
        yield executor
    finally:
        executor.close()


def _count_processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
