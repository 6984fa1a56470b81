"""Who answers batches of designs, and what comes back from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from geometry.common.errors import ProbeError
from probe_design.sweeps.keys import Value
from probe_design.sweeps.rows import Row


@dataclass(frozen=True)
class Task:
    """A design to be answered.

    Attributes:
        key: of its row.
        values: of the variables.
        count: of designs that are the same.
        deaths: how many workers died with it.
        group: number that those share which are answered at once, and belong in one batch; None where any may be.
    """

    key: bytes
    values: tuple[Value, ...]
    count: int = 1
    deaths: int = 0
    group: int | None = None


class CrewError(ProbeError):
    """No worker can answer: what is wrong is none of the designs."""


Batch = tuple[Task, ...]


@dataclass(frozen=True)
class Outcome:
    """What a worker made of the designs of a batch.

    Attributes:
        rows: of the first ones.
        held: how many after these it was working on when it ended; 0 if nothing happened to them.
        ended: how it ended.
        late: whether it was ended for taking too long.
        refused: why no worker can ever answer.
    """

    rows: tuple[Row, ...] = ()
    held: int = 0
    ended: str = ""
    late: bool = False
    refused: str = ""


@dataclass(frozen=True)
class FinishedBatch:
    """A batch that is back, and what became of it."""

    batch: Batch
    outcome: Outcome


class Crew(Protocol):
    """Workers, here or elsewhere."""

    def free(self) -> int:
        """Return how many more batches they could begin now."""
        ...

    def size(self) -> int:
        """Return how many there are."""
        ...

    def give(self, batch: Batch) -> None:
        """Hand out a batch."""
        ...

    def take(self, seconds: float) -> list[FinishedBatch]:
        """Wait for answers, at most that long."""
        ...

    def close(self) -> None:
        """Stop them; what they work on is lost."""
        ...
