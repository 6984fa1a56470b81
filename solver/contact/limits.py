"""Find the loads at which the gap closes or linear elasticity no longer holds."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from solver.contact.path import MAX_DEPTH_RELATIVE, Path
from solver.contact.states import PathPoint
from solver.results.load_limits import LargestLoad

BRACKET_WIDTH_RELATIVE = 0.01  # width of the final bracket of a limit, relative to its indentation
MAX_BRACKET_STEPS = 8
CLOSED_GAP_RELATIVE = 2e-3  # of the gap: closer walls count as touching, because contact pressures are rounded over this distance


def find_gap_closure_load(path: Path) -> LargestLoad | None:
    """Find the load at which the gap's walls touch; None if they do not touch up to ``MAX_DEPTH_RELATIVE``.

    Walls approach each other faster and faster, so that the load cannot be extrapolated: the path is followed until they touch,
    and the bracket is then narrowed by extrapolating the last gaps to zero.

    Raises
    ------
    StoppedError
        No further step converges, and the gap is still open.
    LimitReached
        The time limit is reached.
    """
    if not is_gap_closed(path):
        for _ in path.iterate_steps(MAX_DEPTH_RELATIVE * path.radius):
            if is_gap_closed(path):
                break
    gap = path.points[0].walls
    return _find_first_load(path, lambda point: _is_touching(path, point), lambda point: point.walls / gap, "gap closure")


def is_gap_closed(path: Path) -> bool:
    """Return whether the gap's walls touch at any point of a path."""
    return any(_is_touching(path, point) for point in path.points)


def _is_touching(path: Path, point: PathPoint) -> bool:
    """Return whether the gap's walls are close enough at a point of a path to count as touching."""
    return point.walls <= CLOSED_GAP_RELATIVE * path.points[0].walls


def find_change_load(path: Path, value: Callable[[PathPoint], float], allowed: float, quantity: str) -> LargestLoad | None:
    """Find the load at which a value has changed from its value at rest by the allowed relative amount.

    Parameters
    ----------
    path
        A load path, pressed as far as is wanted.
    value
        Function that gives the value at a point; a value of 0 at rest sets no limit.
    allowed
        Relative change, above 0.
    quantity
        Name of the value, for the result.

    Returns
    -------
    LargestLoad | None
        The load, or None if the path does not reach that change.

    Raises
    ------
    StoppedError, LimitReached
        See ``find_gap_closure_load``.
    """
    rest_value = value(path.points[0])
    if rest_value == 0:
        return None

    def compute_margin(point: PathPoint) -> float:
        """Return the part of the allowed change that is left at a point, 1 at rest and 0 at the limit."""
        return 1 - abs(value(point) / rest_value - 1) / allowed

    return _find_first_load(path, lambda point: compute_margin(point) <= 0, compute_margin, quantity)


def _find_first_load(
    path: Path, has_ended: Callable[[PathPoint], bool], compute_margin: Callable[[PathPoint], float], quantity: str
) -> LargestLoad | None:
    """Narrow down the first load of a path at which a limit is reached; return None if no point reaches it.

    The load of the last point below the limit is returned.

    Parameters
    ----------
    path
        A load path; points are added to it as the bracket is narrowed.
    has_ended
        Function that returns whether a point has reached the limit.
    compute_margin
        Function that falls to zero at the limit, by which the next point is chosen.
    quantity
        Name of the limited value, for the result.
    """
    if not any(map(has_ended, path.points)):
        return None
    for _ in range(MAX_BRACKET_STEPS):
        k = next(k for k, point in enumerate(path.points) if has_ended(point))
        lower, upper = path.points[k - 1], path.points[k]
        width = upper.indentation - lower.indentation
        if width <= BRACKET_WIDTH_RELATIVE * upper.indentation:
            break
        path.insert(lower.indentation + width * _estimate_share(path.points[max(0, k - 3) : k], upper, compute_margin))
    return LargestLoad(lower.force, lower.indentation, quantity)


def _estimate_share(open_points: list[PathPoint], upper: PathPoint, compute_margin: Callable[[PathPoint], float]) -> float:
    """Estimate where the margin vanishes between two points of a path, as a fraction from 0.1 to 0.9 of the distance.

    A parabola through the last points below the limit is extrapolated.

    Parameters
    ----------
    open_points
        Up to three last points below the limit.
    upper
        The point after them, at which the limit is reached.
    compute_margin
        See ``_find_first_load``.
    """
    last, width = open_points[-1], upper.indentation - open_points[-1].indentation
    places = [(point.indentation - last.indentation) / width for point in open_points]
    if len(set(places)) < 3:  # a search for a force that jumps leaves several points at one indentation
        return 0.5
    # margin = a x^2 + b x + c at the fraction x of the distance; its roots are candidates
    a, b, c = np.polyfit(places, [compute_margin(point) for point in open_points], 2)
    root = b * b - 4 * a * c
    candidates = [(-b + sign * math.sqrt(root)) / (2 * a) for sign in (1, -1)] if root >= 0 and a else []
    inside = [x for x in candidates if 0 < x < 1]
    return float(np.clip(min(inside, default=0.5), 0.1, 0.9))
