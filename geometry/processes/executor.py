"""Define the interface of executors, which evaluate batches of items in other processes, of their jobs and outcomes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from geometry.common.errors import ProbeError

Item = TypeVar("Item")
ItemIn = TypeVar("ItemIn", contravariant=True)
Row = TypeVar("Row")


class ExecutorError(ProbeError):
    """The workers cannot run, for a reason that is not in the items."""


class Job(Protocol[ItemIn, Row]):
    """The work of a worker: evaluate items (designs, say) to rows of results.

    It has to be picklable, and its module importable by a worker.
    """

    def warm_up(self) -> None:
        """Load what is needed, before the first item; raise any exception where this worker cannot do the job."""
        ...

    def count_parts(self, items: Sequence[ItemIn]) -> list[int]:
        """Return the sizes of consecutive parts of ``items`` that are evaluated together."""
        ...

    def evaluate_parts(self, items: Sequence[ItemIn]) -> Iterator[list[Row]]:
        """Yield a list of rows for each part, or for each item of a part that cannot be evaluated together."""
        ...


@dataclass(frozen=True)
class Outcome(Generic[Row]):
    """The result of a batch of items.

    Attributes
    ----------
    rows
        Of the first items.
    unfinished
        Number of items after these that the worker evaluated when it ended; 0 if it did not end.
    failure
        How the worker ended; empty if it did not.
    is_late
        Whether the worker was killed because it took too long.
    refusal
        Why no worker can evaluate any item; empty if they can.
    """

    rows: tuple[Row, ...] = ()
    unfinished: int = 0
    failure: str = ""
    is_late: bool = False
    refusal: str = ""


class Executor(Protocol[ItemIn, Row]):
    """Workers on this computer or a cluster, with limits of time and memory of each item."""

    def count_free(self) -> int:
        """Return how many more batches can be submitted now."""
        ...

    def count_workers(self) -> int:
        """Return the number of workers."""
        ...

    def submit(self, items: Sequence[ItemIn]) -> int:
        """Give a batch to a worker, and return the number by which ``collect`` names it."""
        ...

    def collect(self, seconds: float) -> list[tuple[int, Outcome[Row]]]:
        """Return the batches that are finished, each by its number from ``submit`` with its outcome.

        Waits until there is one, at most for ``seconds``; the list is empty if none has finished by then. Each batch is returned
        once.
        """
        ...

    def close(self) -> None:
        """Stop all workers; unfinished batches are lost."""
        ...
