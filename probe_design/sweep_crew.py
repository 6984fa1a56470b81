"""Who answers batches of designs, and what comes back from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from geometry.errors import ProbeError
from probe_design.sweep_keys import Value
from probe_design.sweep_rows import Row


@dataclass(frozen=True)
class Task:
    """A design to be answered.

    Attributes:
        key: of its row.
        values: of the variables.
        count: of designs that are the same.
        deaths: how many workers died with it.
    """

    key: bytes
    values: tuple[Value, ...]
    count: int = 1
    deaths: int = 0


class CrewError(ProbeError):
    """No worker can answer: what is wrong is none of the designs."""


Batch = tuple[Task, ...]


@dataclass(frozen=True)
class Answer:
    """What became of a batch.

    Attributes:
        batch: the designs.
        rows: one for each; None where there is no answer.
        died: how their worker died.
        refused: why no worker can ever answer.
    """

    batch: Batch
    rows: list[Row] | None
    died: str = ""
    refused: str = ""


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

    def take(self, seconds: float) -> list[Answer]:
        """Wait for answers, at most that long."""
        ...

    def close(self) -> None:
        """Stop them; what they work on is lost."""
        ...
