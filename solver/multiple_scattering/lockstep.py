"""Advance many sets of spheres at one boundary together, so that each azimuthal order is solved for all sets at once.

The reflections of a set are a generator, which yields an order's ``Response`` with data, one column or several, and receives the
response of the same shape. A factorised system takes hardly longer for the data of eight sets than for those of one.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import Protocol, TypeVar

import numpy as np

from geometry.common.arrays import Floats


class Response(Protocol):
    """The linear response of one azimuthal order to data on the boundary."""

    def apply(self, data: Floats, often: bool, /) -> Floats:
        """Return the response to data, shape (n, k) both; ``often`` says that many calls will follow."""
        ...


OrderRequest = tuple[Response, Floats]
T = TypeVar("T")
Steps = Generator[OrderRequest, Floats, T]


def run_in_lockstep(all_steps: Sequence[Steps[T]], often: bool = False) -> list[T]:
    """Run the steps of all sets together and return their results, in order.

    Each turn solves the order for which most sets wait, for all of these at once.
    """
    results: dict[int, T] = {}
    waiting: dict[int, OrderRequest] = {}

    def advance(k: int, solution: Floats | None) -> None:
        """Send set k its solution (None to begin); store its next request, or its result at the end."""
        try:
            waiting[k] = next(all_steps[k]) if solution is None else all_steps[k].send(solution)
        except StopIteration as end:
            results[k] = end.value

    for k in range(len(all_steps)):
        advance(k, None)
    while waiting:
        groups: dict[int, list[int]] = {}
        for k, (response, _) in waiting.items():
            groups.setdefault(id(response), []).append(k)
        largest_group = max(groups.values(), key=len)
        requests = [waiting.pop(k) for k in largest_group]
        ends = np.cumsum([data.shape[1] for _, data in requests])[:-1]
        solutions = requests[0][0].apply(np.concatenate([data for _, data in requests], axis=1), often)  # one solve
        for k, solution in zip(largest_group, np.split(solutions, ends, axis=1), strict=True):
            advance(k, solution)
    return [results[k] for k in range(len(all_steps))]
