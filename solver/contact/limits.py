"""Loads at which something ends: the gap closes, linear elasticity no longer holds."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from solver.contact.path import DEEPEST, Path
from solver.contact.pressed import Pressed
from solver.results.load_limits import LargestLoad

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


def change_load(path: Path, value: Callable[[Pressed], float], allowed: float, by: str) -> LargestLoad | None:
    """Return the load at which a value is off the one at rest by as much as is allowed, relative.

    Args:
        path: pressed as far as is wanted.
        value: of a point; the load does not matter where it is 0 at rest.
        allowed: above 0.
        by: what is said to set the load.

    Returns:
        None where that does not happen on the path.

    Raises:
        StoppedError, LimitReached: see ``gap_closure_load``.
    """
    rest = value(path.points[0])
    if rest == 0:
        return None

    def left(point: Pressed) -> float:
        return 1 - abs(value(point) / rest - 1) / allowed

    return _first(path, lambda point: left(point) <= 0, left, by)


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
