"""A sweep from its file to its store: what has a row is kept, what has none is answered in batches, whoever dies meanwhile."""

from __future__ import annotations

import hashlib
import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from geometry.errors import InputError
from probe_design.sweep_crew import Answer, Batch, Crew, CrewError, Task
from probe_design.sweep_file import Sweep, read_sweep, sweep_from_dict
from probe_design.sweep_local import LocalCrew
from probe_design.sweep_progress import Progress, Tell, logged
from probe_design.sweep_rows import Job, Row, blank
from probe_design.sweep_store import Store, writing

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

SECONDS = 0.5  # of work in a batch: some hundred times the cost of handing it out, and what a kill may cost
LARGEST = 2000  # designs in a batch
TRIES = 2  # workers that may die with a design on its own before it counts as failed


@dataclass(frozen=True)
class Swept:
    """A finished sweep.

    Attributes:
        folder: where its store is.
        designs: how many it has, with a row each.
        left_out: designs that do not meet the constraints; they have no row.
        ok, refused, failed: rows by status.
        answered: rows that this run added; the others were there.
        seconds: what this run took.
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
        """Return all rows; see ``sweep_results.dataframe``."""
        from probe_design.sweep_results import dataframe

        return dataframe(self.folder)

    def dataset(self) -> xr.Dataset:
        """Return all rows with labels and units; see ``sweep_results.dataset``."""
        from probe_design.sweep_results import dataset

        return dataset(self.folder)


def sweep(
    asked: Sweep | Mapping[str, Any] | Path | str,
    output: Path | str,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Tell | None = None,
) -> Swept:
    """Answer every design of a sweep that has no row in ``output`` yet.

    Args:
        asked: the name of a sweep file, or its tables; numbers are then in SI units and ``scene`` may be a ``Scene``.
        output: folder of the store.
        scheduler: address of a Dask scheduler, ``tcp://host:8786``; processes on this computer without.
        workers: how many processes; one for each processor without.
        progress: called with the state after each batch.

    Raises:
        InputError: the sweep is not allowed, or another process is writing to the folder.
        StoreError: the store cannot be read or written; committed rows are kept.
        CrewError: workers do not start, have another version of this program, or the scheduler is gone for good; likewise.
        KeyboardInterrupt: likewise.
    """
    start = monotonic()
    wanted = asked if isinstance(asked, Sweep) else _checked(asked)
    if workers is not None and not 1 <= workers <= 1024:
        raise InputError("workers", workers, "a whole number from 1 to 1024")
    if workers is not None and scheduler is not None:
        raise InputError("workers", workers, "none with a scheduler, which has its own")
    folder = Path(output)
    with writing(folder) as store, logged(folder, progress) as (tell, log):
        job = Job.of(wanted)
        total, left_out = _begun(store, wanted, job)
        tasks = [Task(key, values, count) for count, values, key in store.missing()]
        log(f"begins: {total} designs, {len(tasks)} to be answered, version {job.version}")
        if tasks:
            with _crew(job, scheduler, workers or _processors(), folder, min(len(tasks), 1024)) as crew:
                _Run(store, crew, tell, log, total).answer(tasks)
        counts = store.counts()
        log(f"ends: {counts}")
    return Swept(folder, total, left_out, **counts, answered=len(tasks), seconds=monotonic() - start)


class _Run:
    """The work of one run."""

    def __init__(self, store: Store, crew: Crew, tell: Tell, log: Callable[[str], None], total: int) -> None:
        self._store, self._crew, self._tell, self._log, self._total = store, crew, tell, log, total
        self._begun, self._counts = monotonic(), store.counts()
        self._before = sum(self._counts.values())
        self._cost = SECONDS  # seconds a row, as measured; a first batch is one design

    def answer(self, tasks: list[Task]) -> None:
        """Answer all of them."""
        waiting, alone, out = deque(tasks), deque[Task](), 0
        self._told()
        while waiting or alone or out:
            while (waiting or alone) and self._crew.free() > 0:
                self._crew.give((alone.popleft(),) if alone else self._batch(waiting))
                out += 1
            for answer in self._crew.take(1.0):
                out -= 1
                alone.extend(self._taken(answer))
            self._told()

    def _batch(self, waiting: deque[Task]) -> Batch:
        """The next designs: half a second of work, less towards the end so that all workers end together."""
        share = len(waiting) / (2 * max(1, self._crew.size()))
        count = max(1, min(int(SECONDS / self._cost), LARGEST, int(share)))
        return tuple(waiting.popleft() for _ in range(min(count, len(waiting))))

    def _taken(self, answer: Answer) -> list[Task]:
        """Commit rows; return the designs that another worker must try, each alone."""
        if answer.refused:
            raise CrewError(answer.refused)
        if answer.rows is not None:
            self._commit(answer.batch, answer.rows)
            cost = sum(row["seconds"] for row in answer.rows) / len(answer.rows)
            self._cost = max(0.5 * (self._cost + cost), 1e-6)
            return []
        self._log(f"a worker died with {len(answer.batch)} designs: {answer.died}")
        if len(answer.batch) > 1:
            return list(answer.batch)
        task = answer.batch[0]
        if task.deaths + 1 < TRIES:
            return [replace(task, deaths=task.deaths + 1)]
        self._commit(answer.batch, [blank("failed", f"{TRIES} times in a row, {answer.died}", 0.0)])
        return []

    def _commit(self, batch: Batch, rows: list[Row]) -> None:
        self._store.add([(task.key, row) for task, row in zip(batch, rows, strict=True)])
        for task, row in zip(batch, rows, strict=True):
            self._counts[row["status"]] += task.count

    def _told(self) -> None:
        done = sum(self._counts.values())
        rate = (done - self._before) / max(monotonic() - self._begun, 1e-9)
        counts = (self._counts["refused"], self._counts["failed"])
        self._tell(Progress(self._total, done, *counts, rate, self._crew.size()))


def _checked(asked: Mapping[str, Any] | Path | str) -> Sweep:
    return sweep_from_dict(asked) if isinstance(asked, Mapping) else read_sweep(asked)


def _begun(store: Store, wanted: Sweep, job: Job) -> tuple[int, int]:
    """Note the designs unless they are noted already; returns how many there are and how many constraints left out."""
    drawn = wanted.sample.count(wanted.variables)
    asked = hashlib.sha256(repr((wanted, job)).encode() + _surfaces(wanted, job)).hexdigest()
    about = store.about()
    if about.get("digest") != asked:
        keys = wanted.keys
        designs = [(number, values, job.digest(keys, values)) for number, values in wanted.designs()]
        store.begin(_about(wanted, job) | {"digest": asked, "designs": len(designs)}, designs)
        about = {"designs": len(designs)}
    return int(about["designs"]), drawn - int(about["designs"])


def _about(wanted: Sweep, job: Job) -> dict[str, Any]:
    """What readers of the store need to know."""
    grid = wanted.sample.kind == "grid"
    variables = [
        {"name": one.key.name, "unit": one.key.unit, "values": list(one.values) if grid else [], "log": one.log}
        for one in wanted.variables
    ]
    sample = asdict(wanted.sample)
    return {**asdict(job), "variables": variables, "sample": sample, "constraints": list(wanted.constraints)}


def _surfaces(wanted: Sweep, job: Job) -> bytes:
    """Content of the surface files of the scene."""
    return job.digest((), ()) if any(body.get("surface") for body in wanted.base.get("inclusion", ())) else b""


@contextmanager
def _crew(job: Job, scheduler: str | None, workers: int, folder: Path, most: int) -> Iterator[Crew]:
    crew: Crew
    if scheduler is None:
        crew = LocalCrew(job, min(workers, most), folder / "workers.log")
    else:
        from probe_design.sweep_dask import DaskCrew

        crew = DaskCrew(job, scheduler)
    try:
        yield crew
    finally:
        crew.close()


def _processors() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
