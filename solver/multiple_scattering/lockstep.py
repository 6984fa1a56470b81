"""Advance many sets of spheres at one boundary together: each azimuthal order responds to all of them at once.

The reflections of a set are a generator. It yields an order's ``BoundaryResponse`` with data (6 n, k), and receives the response
of the same shape. A factorised system takes hardly longer for the data of eight sets than for those of one.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import TypeVar

import numpy as np

from geometry.common.arrays import Floats
from solver.multiple_scattering.boundary_compliance import BoundaryResponse

Question = tuple[BoundaryResponse, Floats]
Found = TypeVar("T")
Steps = Generator[Question, Floats, Found]


def alone(steps: Steps[Found], often: bool) -> Found:
    """Run the steps of one set and return its result; ``often`` as in ``BoundaryResponse.apply``."""
    try:
        response, data = next(steps)
        while True:
            response, data = steps.send(response.to(data, often))
    except StopIteration as end:
        found: Found = end.value
        return found


def together(every: Sequence[Steps[Found]]) -> list[Found]:
    """Run the steps of all sets and return their results; the next order is the one for which most sets wait."""
    found: dict[int, Found] = {}
    waiting: dict[int, Question] = {}

    def advance(k: int, answer: Floats | None) -> None:
        """Send a set its response; store its next question, or its result at the end."""
        try:
            waiting[k] = next(every[k]) if answer is None else every[k].send(answer)
        except StopIteration as end:
            found[k] = end.value

    for k in range(len(every)):
        advance(k, None)
    while waiting:
        groups: dict[int, list[int]] = {}
        for k, (response, _) in waiting.items():
            groups.setdefault(id(response), []).append(k)
        most = max(groups.values(), key=len)
        asked = [waiting.pop(k) for k in most]
        ends = np.cumsum([data.shape[1] for _, data in asked])[:-1]
        answers = asked[0][0].to(np.concatenate([data for _, data in asked], axis=1), False)
        for k, answer in zip(most, np.split(answers, ends, axis=1), strict=True):
            advance(k, answer)
    return [found[k] for k in range(len(every))]
