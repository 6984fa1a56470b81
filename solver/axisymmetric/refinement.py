"""Refine meshes until the accuracy is reached, and bound the remaining errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from geometry.common.resources import LimitReached
from geometry.meridian.frame import MeridianFineness
from solver.axisymmetric.sample import MeshSample
from solver.results.warnings import Note

# order, layers at corners and at last the number of cells rise together: errors fall by 3 to 10 from one to the next
LEVELS = (
    MeridianFineness(1, 2, 3),
    MeridianFineness(1, 2, 4, lean=True),
    MeridianFineness(1, 3, 5, lean=True),
    MeridianFineness(1, 3, 6, lean=True),
    MeridianFineness(1, 4, 8),
    MeridianFineness(1.5, 5, 8),
    MeridianFineness(2, 6, 8),
)
COARSE_ENOUGH = (3e-3, 3e-4)  # accuracies below which the first and the second mesh are left out
LIGHT = MeridianFineness(0.7, 1, 4, lean=True)  # tried first at low accuracy
LIGHT_FOR = 3e-3  # below it the light mesh is seldom accurate enough
BELIEVED = 0.01  # wider bounds of the light mesh are not trusted: its changes may not yet fall
ONE_MESH = (4, 5, 6)  # orders of meshes that bound their own errors
CROSSED = (5, 6, 8)  # where interfaces cross the sphere: order 4 gave half of an error there
UNSEEN_DROP = 1.5  # of errors from one mesh to the next, before it is measured
LEAST_SHARE = 1.5  # smallest error bound, times the last change
GUARD = 0.3  # share of the largest change that eq. AX.2 allows
LEAST_MEMORY = 0.1  # smallest error bound, times the change before the last


@dataclass(frozen=True)
class SampleErrors:
    """Bounds on the errors of a sample: of each film's total, shape (k, 2), and of the log-sensitivities, shape (k,)."""

    totals: Floats
    sensitivity: Floats


def refine(
    solve: Callable[[MeridianFineness], MeshSample],
    accuracy: float,
    good: Callable[[MeshSample, SampleErrors], bool],
    alone: Sequence[Callable[[MeshSample], SampleErrors | None]] = (),
    *,
    margin: float = 1.0,
    told: Sequence[int] = ONE_MESH,
) -> tuple[MeshSample, SampleErrors, str | None]:
    """Return the first sample that is accurate enough with its errors, or the best that could be solved.

    The last of the three results explains why no finer mesh was used, if one was needed: a ``Note`` where a limit prevented it.

    Args:
        solve: solves on a mesh.
        accuracy: relative.
        is_good: returns whether a sample with its errors is accurate enough.
        one_mesh_bounds: functions that bound the errors of a sample from its own mesh or return None, the cheapest first.
        margin: factor of error bounds from several meshes; above 1 they are used only where no mesh bounds its own errors.
        one_mesh_orders: orders of the meshes that can bound their own errors.

    Raises:
        SolveError: the meshes that a first bound needs could not be solved.
        LimitReached: they could not be solved within the limits.
    """
    history: dict[MeridianFineness, MeshSample] = {}
    best: tuple[MeshSample, SampleErrors] | None = None
    for level in _ladder(accuracy, bool(alone), margin == 1):
        if alone and margin > 1 and level.order < min(told):
            continue
        try:
            found = solve(level)
            if level != LIGHT:
                history[level] = found
            solved = [history[one] for one in LEVELS if one in history]
            own = alone if level.order in told else ()
            for bounds in _known(found, solved if margin == 1 or not own else [found], own, margin):
                finest = found if level == LIGHT else solved[-1]
                if level == LIGHT and _worst(finest, bounds) > BELIEVED:
                    continue
                if good(finest, bounds):
                    return finest, bounds, None
                if best is None or _worst(finest, bounds) < _worst(*best):  # rounding may grow from mesh to mesh
                    best = finest, bounds
        except (SolveError, LimitReached) as fault:
            if best is None:
                raise
            return *best, Note("limit", str(fault)) if isinstance(fault, LimitReached) else str(fault)
    assert best is not None  # there are more than two levels
    return *best, "this is the finest"


def _ladder(accuracy: float, alone: bool, several: bool) -> Sequence[MeridianFineness]:
    """Return the meshes to solve, in order.

    Where one mesh bounds its own error, the second mesh comes first. If that is not accurate enough, and bounds from several
    meshes are trusted, the cheap first mesh follows and gives another bound.
    """
    levels = LEVELS[sum(accuracy < limit for limit in COARSE_ENOUGH) :]
    if not alone:
        return levels
    return (*((LIGHT,) if accuracy >= LIGHT_FOR else ()), levels[1], *levels[:several], *levels[2:])


def _known(
    found: MeshSample,
    solved: Sequence[MeshSample],
    alone: Iterable[Callable[[MeshSample], SampleErrors | None]],
    margin: float,
) -> Iterator[SampleErrors]:
    """Yield bounds on the errors of the sample on the finest mesh: from several meshes, and from that mesh alone."""
    light = all(found is not one for one in solved)
    if len(solved) > 1 and not light:
        told = errors(solved)
        yield SampleErrors(margin * told.totals, margin * told.sensitivity)
    if light or found is solved[-1]:
        yield from (bounds for one in alone if (bounds := one(found)) is not None)


def _worst(sample: MeshSample, bounds: SampleErrors) -> float:
    """Return the largest relative error bound of a film's force."""
    return float(np.max(bounds.totals / np.maximum(np.abs(sample.totals), 1e-300)))


def errors(history: Sequence[MeshSample]) -> SampleErrors:
    """Bound the errors of the last of at least two samples by the changes between them.

    By Galerkin's orthogonality the error of film i's total is the energy product of the errors of state i and of the sum U of
    both states, and so at most sqrt(e_ii e_UU), e the errors of F_ii and of the stiffness (AX.2). A part of it guards
    against changes that cancel in a total by chance.
    """
    changes = [total_change(b.forces - a.forces) for a, b in pairwise(history)]
    sensitivity_changes = [np.abs(b.log_sensitivity - a.log_sensitivity) for a, b in pairwise(history)]
    return SampleErrors(_remaining_error(changes) + history[-1].rounding, _remaining_error(sensitivity_changes))


def total_change(change: Floats) -> Floats:
    """Return the change of both totals, shape (k, 2), from the change of F_ij, shape (k, 2, 2), by eq. AX.2."""
    single, whole = np.abs(np.diagonal(change, axis1=1, axis2=2)), np.abs(change.sum(axis=(1, 2)))[:, None]
    return np.asarray(np.maximum(np.abs(change.sum(axis=2)), GUARD * np.sqrt(single * whole)))


def _remaining_error(changes: Sequence[Floats]) -> Floats:
    """Bound the error that remains after the last of several changes.

    If errors fall by q from level to level, 1 / (q - 1) of the last change is left (AX.3). q is taken as ASSUMED_DECAY until a
    second change gives it. The bound is at least MIN_CHANGE_SHARE of the last change and MIN_PREVIOUS_CHANGE_SHARE of the one
    before.
    """
    if len(changes) == 1:
        return np.asarray(changes[0] / (UNSEEN_DROP - 1))
    decay = np.clip(changes[-2] / np.maximum(changes[-1], 1e-300), 1.2, None)
    return np.asarray(np.maximum(changes[-1] * np.maximum(LEAST_SHARE, 1 / (decay - 1)), LEAST_MEMORY * changes[-2]))
