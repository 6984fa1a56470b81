"""Run a sweep: evaluate every design that has no row in the store yet."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

from geometry.common.calls import check_call
from geometry.common.errors import InputError
from geometry.common.files import write_text
from geometry.common.json_types import JsonMapping, JsonObject
from geometry.common.resources import Limits
from geometry.processes.executor import Executor
from geometry.processes.local_executor import LocalExecutor
from geometry.provenance.block import build_provenance
from geometry.scenes.scene import Scene
from geometry.scenes.units import SI_CONTEXT
from probe_design.sweeps import results
from probe_design.sweeps.batches import BatchRun, Log, Task, order_tasks
from probe_design.sweeps.designs import check_integer
from probe_design.sweeps.file import Sweep, read_sweep, sweep_from_dict
from probe_design.sweeps.progress import ReportProgress, open_log, report_at_intervals
from probe_design.sweeps.rows import Design, Job, Row
from probe_design.sweeps.store import Store, StoreError, open_for_writing
from solver.results.record import Record

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


@dataclass(frozen=True, repr=False)
class SweepSummary(Record):
    """A finished sweep.

    Attributes
    ----------
    folder
        Folder of its store.
    designs
        Number of designs, each with a row.
    left_out
        Number of designs that do not satisfy the constraints; they have no row.
    ok, refused, failed
        Number of rows by status.
    answered
        Number of rows that this run added.
    seconds
        Wall clock of this run.
    """

    folder: Path
    designs: int
    left_out: int
    ok: int
    refused: int
    failed: int
    answered: int
    seconds: float

    def as_dict(self) -> JsonObject:
        """Return the JSON object of ``probe-design sweep``."""
        return super().as_dict() | {"folder": str(self.folder)}

    def to_frame(self) -> pd.DataFrame:
        """Return all rows; see ``probe_design.sweeps.results.dataframe``."""
        return results.dataframe(self.folder)

    def to_dataset(self) -> xr.Dataset:
        """Return all rows with labels and units; see ``probe_design.sweeps.results.dataset``."""
        return results.dataset(self.folder)


@check_call
def sweep(
    specification: Sweep | JsonMapping | Path | str,
    output: Path | str,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: ReportProgress | None = None,
    retry_failed: bool = False,
    notice: Log | None = None,
) -> SweepSummary:
    """Evaluate every design of a sweep that has no row in ``output`` yet.

    Parameters
    ----------
    specification
        The name of a sweep file, or its tables; numbers are then in SI units and ``scene`` may be a ``Scene``.
    output
        Folder of the store.
    scheduler
        Address of a Dask scheduler, ``tcp://host:8786``; by default processes on this computer are used.
    workers
        Number of processes; by default one for each processor.
    progress
        Called with a ``Progress`` after each batch.
    retry_failed
        Whether designs whose row is ``failed`` are evaluated again; the new row replaces the old one. Designs that were stopped,
        or kept from a finer result, by a limit that is larger now are always evaluated again.
    notice
        Called with a line when the sweep has to wait, such as for a Dask scheduler that does not respond.

    Raises
    ------
    InputError
        The specification is not valid, or another process is writing to the folder.
    StoreError
        The store cannot be read or written, or is moved or deleted meanwhile. Committed rows are kept.
    ExecutorError
        Workers do not start, have another version of this program, or the scheduler is lost for good. Committed rows are kept.
    KeyboardInterrupt
        Committed rows are kept.
    """
    start = monotonic()
    if not isinstance(specification, Sweep | Mapping | Path | str):
        raise InputError("specification", specification, "the name of a sweep file, or its tables")
    if not isinstance(output, Path | str):
        raise InputError("output", output, "the name of a folder")
    checked_sweep = specification if isinstance(specification, Sweep) else _read_specification(specification)
    if workers is not None:
        check_integer("workers", workers, 1, 1024)
    if workers is not None and scheduler is not None:
        raise InputError("workers", workers, "none with a scheduler, which has its own")
    folder = Path(output)
    with open_for_writing(folder) as store, open_log(folder) as log:
        job = Job.from_sweep(checked_sweep)

        def log_notice(text: str) -> None:
            """Write a line to the log, and pass it to ``notice``."""
            log(text)
            if notice is not None:
                notice(text)

        if store.repair_note:
            log_notice(store.repair_note)
        total, left_out = _begin(store, checked_sweep, job)
        if forgotten := store.delete_limited_rows(checked_sweep.limits):
            log(f"forgets {forgotten} rows that smaller limits stopped, or kept from a finer result")
        if retry_failed:
            log(f"forgets {store.forget('failed')} failed rows")
        tasks = order_tasks(job, [Task(key, values, count) for count, values, key in store.find_missing()])
        log(f"begins: {total} designs, {len(tasks)} to be evaluated, version {job.version}")
        if tasks:
            processes = min(workers or _count_processors(), len(tasks))
            executor = _start_executor(job, scheduler, processes, limits=checked_sweep.limits, folder=folder, log=log_notice)
            with closing(executor):
                reporters = [report_at_intervals(log), *([] if progress is None else [progress])]
                run = BatchRun(store, executor, reporters, log, total=total, seconds=checked_sweep.limits.seconds)
                run.process_tasks(tasks)
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
    write_text(summary.folder / results.PROVENANCE_FILE, json.dumps(counts | {"provenance": origin}, indent=2) + "\n")


def _read_specification(specification: JsonMapping | Path | str) -> Sweep:
    """Return the sweep of a file or of tables. Raises ``InputError``."""
    return sweep_from_dict(specification) if isinstance(specification, Mapping) else read_sweep(specification)


def _begin(store: Store, sweep: Sweep, job: Job) -> tuple[int, int]:
    """Store request and designs unless they are stored already; return the number of designs and that of excluded ones."""
    drawn_count = sweep.sample.count_designs(sweep.variables)
    # identifies the request; limits do not change results, so that a sweep goes on with others
    digest = hashlib.sha256(repr((replace(sweep, limits=Limits()), job)).encode() + _digest_surfaces(sweep, job)).hexdigest()
    request = store.read_request()
    if request.get("digest") != digest:
        keys = sweep.keys
        designs = [(number, values, job.compute_digest(keys, values)) for number, values in sweep.list_designs()]
        store.begin(_describe_request(sweep, job) | {"digest": digest, "designs": len(designs)}, designs)
        request = {"designs": len(designs)}
    return int(request["designs"]), drawn_count - int(request["designs"])


def _describe_request(sweep: Sweep, job: Job) -> JsonObject:
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


def _start_executor(
    job: Job, scheduler: str | None, workers: int, *, limits: Limits, folder: Path, log: Log
) -> Executor[Design, Row]:
    """Start the executor on a Dask cluster or this computer."""
    if scheduler is None:
        return LocalExecutor(job, workers, limits, folder / "workers.log")
    from geometry.processes.dask_executor import DaskExecutor

    return DaskExecutor(job, scheduler, limits, log)


def _count_processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
