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
from geometry.provenance.block import provenance
from geometry.scenes.scene import Scene
from geometry.scenes.units import SI
from probe_design.sweeps.file import Sweep, read_sweep, sweep_from_dict
from probe_design.sweeps.local_workers import LocalCrew
from probe_design.sweeps.progress import Progress, Tell, logged
from probe_design.sweeps.rows import MODULI, Job, Row, blank
from probe_design.sweeps.store import Store, StoreError, writing
from probe_design.sweeps.variables import whole
from probe_design.sweeps.workers import Batch, Crew, CrewError, FinishedBatch, Outcome, Task
from solver.results.notebook import Notebook

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

SECONDS = 0.5  # of work in a batch: some hundred times the cost of submitting it; a kill may lose it
LARGEST = 2000  # designs in a batch, at most
Log = Callable[[str], None]
ORIGIN = "provenance.json"
FORMULAS = "closed-form"
TRIES = 2  # workers that may die with a design alone in its batch before it counts as failed


@dataclass(frozen=True)
class Swept(Notebook):
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
        return asdict(self) | {"folder": str(self.folder)}

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
) -> Swept:
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
        WorkerPoolError: workers do not start, have another version of this program, or the scheduler is lost for good.
            Committed rows are kept.
        KeyboardInterrupt: committed rows are kept.
    """
    start = monotonic()
    checked = specification if isinstance(specification, Sweep) else _checked(specification)
    if workers is not None:
        whole("workers", workers, 1, 1024)
    if workers is not None and scheduler is not None:
        raise InputError("workers", workers, "none with a scheduler, which has its own")
    folder = Path(output)
    with writing(folder) as store, logged(folder, progress) as (tell, log):
        job = Job.of(checked)
        say = log if notice is None else _both(log, notice)
        if store.mended:
            say(store.mended)
        total, left_out = _begun(store, checked, job)
        if stopped := store.forget_limited(checked.limits):
            log(f"forgets {stopped} rows that smaller limits stopped, or kept from a finer result")
        if retry_failed:
            log(f"forgets {store.forget('failed')} failed rows")
        tasks = _in_order(job, [Task(key, values, count) for count, values, key in store.missing()])
        log(f"begins: {total} designs, {len(tasks)} to be evaluated, version {job.version}")
        if tasks:
            processes = min(workers or _processors(), len(tasks))
            with _crew(job, scheduler, processes, limits=checked.limits, folder=folder, log=say) as crew:
                _Run(store, crew, tell, log, total=total, seconds=checked.limits.seconds).answer(tasks)
        counts = store.counts()
        if sum(counts.values()) != total:
            raise StoreError(f"{folder}: the store has {sum(counts.values())} rows of {total} designs: start again")
        log(f"ends: {counts}")
    swept = Swept(folder, total, left_out, **counts, answered=len(tasks), seconds=monotonic() - start)
    _tell_origin(swept, checked)
    return swept


def _tell_origin(swept: Swept, sweep: Sweep) -> None:
    """Write the counts and the provenance of the rows to ``provenance.json`` in the folder of the sweep."""
    scene = Scene.model_validate(sweep.base, context=SI)
    origin = provenance(scene, evaluator=sweep.evaluator, accuracy=sweep.accuracy, seed=sweep.sample.seed)
    told = {name: getattr(swept, name) for name in ("designs", "left_out", "ok", "refused", "failed")}
    write_text(swept.folder / ORIGIN, json.dumps(told | {"provenance": origin}, indent=2) + "\n")


def _both(log: Log, notice: Log) -> Log:
    """Return a function that logs a line and passes it to the user."""

    def say(text: str) -> None:
        log(text)
        notice(text)

    return say


class _Run:
    """One run of a sweep: gives batches to the worker pool and commits their rows."""

    def __init__(self, store: Store, crew: Crew, tell: Tell, log: Log, *, total: int, seconds: float) -> None:
        self._store, self._crew, self._tell, self._log, self._total, self._seconds = store, crew, tell, log, total, seconds
        self._begun, self._counts = monotonic(), store.counts()
        self._before = sum(self._counts.values())
        self._cost = SECONDS  # seconds per row, as measured; the first batch is one design

    def answer(self, tasks: list[Task]) -> None:
        """Evaluate all tasks; return when each has a row."""
        waiting, alone, out = deque(tasks), deque[Task](), 0
        self._report()
        while waiting or alone or out:
            while (waiting or alone) and self._crew.free() > 0:
                self._crew.give((alone.popleft(),) if alone else self._batch(waiting))
                out += 1
            answers = self._crew.take(1.0)
            self._store.check_place()
            for answer in answers:
                out -= 1
                rest, suspects = self._taken(answer)
                waiting.extendleft(reversed(rest))
                alone.extend(suspects)
            self._report()

    def _batch(self, waiting: deque[Task]) -> Batch:
        """Take the next batch: half a second of work, less at the end so that all workers end together; groups stay whole."""
        share = len(waiting) / (2 * max(1, self._crew.size()))
        count = max(1, min(int(SECONDS / self._cost), LARGEST, int(share)))
        batch = [waiting.popleft() for _ in range(min(count, len(waiting)))]
        while waiting and waiting[0].group is not None and waiting[0].group == batch[-1].group:
            batch.append(waiting.popleft())
        return tuple(batch)

    def _taken(self, answer: FinishedBatch) -> tuple[list[Task], list[Task]]:
        """Commit the rows of a batch; return its tasks that were not started, and those to be tried again, each alone."""
        outcome, count = answer.outcome, len(answer.outcome.rows)
        if outcome.refused:
            raise CrewError(outcome.refused)
        if count:
            self._commit(answer.batch[:count], outcome.rows)
            cost = sum(row["seconds"] for row in outcome.rows) / count
            self._cost = max(0.5 * (self._cost + cost), 1e-6)
        begun, rest = answer.batch[: count + outcome.held], answer.batch[count + outcome.held :]
        again = self._again(begun[count:], outcome) if outcome.held else []
        # the rest of a group whose first designs were evaluated one by one
        broken = [task for task in rest if begun and None is not task.group == begun[-1].group]
        return list(rest[len(broken) :]), [*again, *broken]

    def _again(self, held: Batch, outcome: Outcome) -> list[Task]:
        """Return the tasks to be tried again, each alone, after a worker ended with them; a design that ended it gets a row."""
        why = f"longer than {self._seconds:g} s" if outcome.late else outcome.ended
        self._log(f"a worker ended with {len(held)} designs: {why}")
        if len(held) > 1:
            return list(held)
        task = held[0]
        if outcome.late:
            row = blank("failed", "TimeLimit", f"took {why}", self._seconds) | {"time_limit": self._seconds}
        elif task.deaths + 1 < TRIES:
            return [replace(task, deaths=task.deaths + 1)]
        else:
            row = blank("failed", "WorkerDied", f"{TRIES} times in a row, {outcome.ended}", 0.0)
        self._commit(held, [row])
        return []

    def _commit(self, batch: Batch, rows: Sequence[Row]) -> None:
        """Commit rows and count them by status."""
        self._store.add([(task.key, row) for task, row in zip(batch, rows, strict=True)])
        for task, row in zip(batch, rows, strict=True):
            self._counts[row["status"]] += task.count

    def _report(self) -> None:
        """Report the progress."""
        done = sum(self._counts.values())
        rate = (done - self._before) / max(monotonic() - self._begun, 1e-9)
        counts = (self._counts["refused"], self._counts["failed"])
        self._tell(Progress(self._total, done, *counts, rate, self._crew.size()))


def _in_order(job: Job, tasks: list[Task]) -> list[Task]:
    """Return tasks by number, but with those that can be evaluated together next to each other; the closed form takes any."""
    if job.evaluator == FORMULAS:
        return tasks
    groups: dict[Hashable, list[Task]] = defaultdict(list)
    for task, shared in zip(tasks, job.alike([task.values for task in tasks]), strict=True):
        groups[shared].append(task)
    parts = [group[first : first + MODULI] for group in groups.values() for first in range(0, len(group), MODULI)]
    return [replace(task, group=number) for number, part in enumerate(parts) for task in part]


def _checked(specification: Mapping[str, Any] | Path | str) -> Sweep:
    return sweep_from_dict(specification) if isinstance(specification, Mapping) else read_sweep(specification)


def _begun(store: Store, sweep: Sweep, job: Job) -> tuple[int, int]:
    """Store request and designs unless they are stored already; return the numbers of designs and of excluded ones."""
    drawn = sweep.sample.count(sweep.variables)
    digest = hashlib.sha256(repr((replace(sweep, limits=Limits()), job)).encode() + _surfaces(sweep, job)).hexdigest()
    about = store.about()
    if about.get("digest") != digest:
        keys = sweep.keys
        designs = [(number, values, job.digest(keys, values)) for number, values in sweep.designs()]
        store.begin(_about(sweep, job) | {"digest": digest, "designs": len(designs)}, designs)
        about = {"designs": len(designs)}
    return int(about["designs"]), drawn - int(about["designs"])


def _about(sweep: Sweep, job: Job) -> dict[str, Any]:
    """Return the request of a sweep as readers of the store need it."""
    grid = sweep.sample.kind == "grid"
    variables = [
        {
            "name": one.key.name,
            "unit": one.key.unit,
            "shown": one.key.shown,
            "values": list(one.values) if grid else [],
            "log": one.log,
        }
        for one in sweep.variables
    ]
    sample = asdict(sweep.sample)
    return {**asdict(job), "variables": variables, "sample": sample, "constraints": list(sweep.constraints)}


def _surfaces(sweep: Sweep, job: Job) -> bytes:
    """Return a digest of the base scene with its surface files; empty if it has none."""
    return job.digest((), ()) if any(body.get("surface") for body in sweep.base.get("inclusion", ())) else b""


@contextmanager
def _crew(job: Job, scheduler: str | None, workers: int, *, limits: Limits, folder: Path, log: Log) -> Iterator[Crew]:
    """Open the worker pool on a Dask cluster or this computer, and close it at the end."""
    crew: Crew
    if scheduler is None:
        crew = LocalCrew(job, workers, limits, folder / "workers.log")
    else:
        from probe_design.sweeps.dask_workers import DaskCrew

        crew = DaskCrew(job, scheduler, limits, log)
    try:
        yield crew
    finally:
        crew.close()


def _processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
