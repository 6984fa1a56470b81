"""Evaluate batches of items, part by part: the program of a pool's worker, for ``child.py``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from time import monotonic

from geometry.common.resources import Limits, use_limits
from geometry.processes.executor import Item, Job, Row

MAX_BATCH_TIME_S = 2.0  # seconds after which the rest of a batch is returned: rows are committed only when a batch ends


def run(request: tuple[Job[Item, Row], Limits, Sequence[Item] | None]) -> Iterator[list[Row]]:
    """Yield the rows of items part by part, until the time for a batch is over; without items get ready for the job."""
    job, limits, items = request
    if items is None:
        job.warm_up()
        return
    deadline = monotonic() + MAX_BATCH_TIME_S
    with use_limits(limits):
        for rows in job.evaluate_parts(items):
            yield rows
            if monotonic() > deadline:
                return
