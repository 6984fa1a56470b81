"""Loads at which something ends: the gap closes, linear elasticity no longer holds."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from solver.contact.path import DEEPEST, Path
from solver.contact.pressed import Pressed
from solver.results.result import LargestLoad

NEAR = 0.01  # relative width of the bracket that a limit is told by
TRIES = 8
TOUCHED = 2e-3  # of the gap: closer walls touch, as pressures are rounded over that


def gap_closure_load(path: Path) -> LargestLoad | None:
    """Return the load at which the gap's walls touch; None where they do not before ``DEEPEST``.

    Walls near each other ever faster, so that nothing but the path itself tells: it is followed until they touch, and the bracket
    is narrowed where the last gaps lead to none.

    Raises:
        StoppedError: no further step converges, and the gap is still open.
        LimitReached: the time is over.
    """
    if not closed(path):
        for _ in path.steps(DEEPEST * path.radius):
            if closed(path):
                break
    gap = path.points[0].walls
    return _first(path, lambda point: _touching(path, point), lambda point: point.walls / gap, "gap closure")


def closed(path: Path) -> bool:
    """Whether the gap's walls touch anywhere on a path."""
    return any(_touching(path, point) for point in path.points)


def _touching(path: Path, point: Pressed) -> bool:
    return point.walls <= TOUCHED * path.points[0].walls


def linear_limit_load(
    path: Path, ratio: Callable[[Pressed], float], sensitivity: Callable[[Pressed], float], accuracy: float
) -> LargestLoad | None:
    """Return the load at which ratio, or log-sensitivity, is off its linear value by the accuracy, or five times that, relative.

    Args:
        path: pressed as far as is wanted.
        ratio: of a point.
        sensitivity: likewise; 0 without a target.
        accuracy: relative.

    Returns:
        None where neither happens on the path.

    Raises:
        StoppedError, LimitReached: see ``gap_closure_load``.
    """
    rest = path.points[0]
    first, slope = ratio(rest), sensitivity(rest)

    def off(point: Pressed) -> tuple[float, float]:
        by_sensitivity = abs(sensitivity(point) / slope - 1) / (5 * accuracy) if slope else 0.0
        return abs(ratio(point) / first - 1) / accuracy, by_sensitivity

    found = _first(path, lambda point: max(off(point)) >= 1, lambda point: 1 - max(off(point)), "ratio")
    if found is None:
        return None
    beyond = min((point for point in path.points if max(off(point)) >= 1), key=lambda point: point.indentation)
    return found if off(beyond)[0] >= off(beyond)[1] else LargestLoad(found.force, found.indentation, "log_sensitivity")


def _first(path: Path, ended: Callable[[Pressed], bool], left: Callable[[Pressed], float], by: str) -> LargestLoad | None:
    """Narrow down the first point of a path that has ``ended``; ``left`` falls to zero there."""
    if not any(map(ended, path.points)):
        return None
    for _ in range(TRIES):
        k = next(k for k, point in enumerate(path.points) if ended(point))
        before, after = path.points[k - 1], path.points[k]
        width = after.indentation - before.indentation
        if width <= NEAR * after.indentation:
            break
        path.insert(before.indentation + width * _share(path.points[max(0, k - 3) : k], after, left))
    return LargestLoad(before.force, before.indentation, by)


def _share(open_points: list[Pressed], after: Pressed, left: Callable[[Pressed], float]) -> float:
    """Where between the last point and the one after it nothing is left, by a parabola through the last; well inside."""
    last, width = open_points[-1], after.indentation - open_points[-1].indentation
    places = [(point.indentation - last.indentation) / width for point in open_points]
    if len(set(places)) < 3:  # where the force jumps a search for one leaves points at one place
        return 0.5
    a, b, c = np.polyfit(places, [left(point) for point in open_points], 2)
    root = b * b - 4 * a * c
    candidates = [(-b + sign * math.sqrt(root)) / (2 * a) for sign in (1, -1)] if root >= 0 and a else []
    inside = [x for x in candidates if 0 < x < 1]
    return float(np.clip(min(inside, default=0.5), 0.1, 0.9))
