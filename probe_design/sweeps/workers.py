"""Interface of worker pools, which evaluate batches of designs, and the outcomes that they return."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from geometry.common.errors import ProbeError
from geometry.scenes.keys import Value
from probe_design.sweeps.rows import Row


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
    values: tuple[Value, ...]
    count: int = 1
    deaths: int = 0
    group: int | None = None


class WorkerPoolError(ProbeError):
    """The workers cannot run, for a reason that is not in the designs."""


Batch = tuple[Task, ...]


@dataclass(frozen=True)
class Outcome:
    """What became of the designs of a batch.

    Attributes:
        rows: of the first designs.
        unfinished: number of designs after these that the worker evaluated when it ended; 0 if it did not end.
        failure: how the worker ended.
        is_late: whether the worker was killed because it took too long.
        refusal: why no worker can evaluate any design.
    """

    rows: tuple[Row, ...] = ()
    unfinished: int = 0
    failure: str = ""
    is_late: bool = False
    refusal: str = ""


@dataclass(frozen=True)
class FinishedBatch:
    """A finished batch and its outcome."""

    batch: Batch
    outcome: Outcome


class WorkerPool(Protocol):
    """A pool of workers on this computer or a cluster."""

    def count_free(self) -> int:
        """Return how many more batches can be submitted now."""
        ...

    def count_workers(self) -> int:
        """Return the number of workers."""
        ...

    def submit(self, batch: Batch) -> None:
        """Give a batch to a worker."""
        ...

    def collect(self, seconds: float) -> list[FinishedBatch]:
        """Wait at most ``seconds`` for finished batches."""
        ...

    def close(self) -> None:
        """Stop all workers; unfinished batches are lost."""
        ...
