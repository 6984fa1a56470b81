"""Meshes refined until the error asked for is reached, and the bounds on what is left."""

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
COARSE_ENOUGH = (3e-3, 3e-4)  # accuracies below which the first, the second level is left out
LIGHT = MeridianFineness(0.7, 1, 4, lean=True)  # tried first where none is left out and one mesh tells its own error
LIGHT_FOR = 3e-3  # accuracies it is tried for, or above: it seldom does below
BELIEVED = 0.01  # bounds of its that are believed: where they are wider its changes need not fall yet
ONE_MESH = (4, 5, 6)  # orders of meshes that do
CROSSED = (5, 6, 8)  # likewise where interfaces cross the sphere: order 4 told half of an error where rays were turned much
UNSEEN_DROP = 1.5  # by which errors are trusted to fall from one level to the next before it is seen
LEAST_SHARE = 1.5  # of the last change: the least that the error bound keeps
GUARD = 0.3  # of the largest change that eq. AX.2 allows
LEAST_MEMORY = 0.1  # of the change before that


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
    """Return the first sample that is good enough with its errors, or that of the finest mesh that could be solved.

    The last of the three says why a finer mesh was not used, if one was wanted: a note where a limit forbade it.

    Args:
        solve: solves on a mesh.
        accuracy: relative.
        good: whether a sample with its errors is good enough.
        alone: what may tell the errors of a sample from its own mesh, the cheapest first.
        margin: times what several meshes tell of their errors; above 1 that counts where none tells its own alone.
        told: orders of the meshes that do.

    Raises:
        SolveError: not even two meshes could be solved, or one where that is asked.
        LimitReached: likewise, within the limits.
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
    """The meshes that are solved in turn.

    Where one tells its own error the second comes first, and the coarser, which is cheap, bounds its error where it does not do
    and several are believed.
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
    """Bounds on the errors of the sample on the finest mesh: from several meshes, and from its own."""
    light = all(found is not one for one in solved)
    if len(solved) > 1 and not light:
        told = errors(solved)
        yield SampleErrors(margin * told.totals, margin * told.sensitivity)
    if light or found is solved[-1]:
        yield from (bounds for one in alone if (bounds := one(found)) is not None)


def _worst(sample: MeshSample, bounds: SampleErrors) -> float:
    """The largest relative error bound of a film's force."""
    return float(np.max(bounds.totals / np.maximum(np.abs(sample.totals), 1e-300)))


def errors(history: Sequence[MeshSample]) -> SampleErrors:
    """Bounds on the errors of the last of at least two samples.

    By Galerkin's orthogonality the error of film i's total is the energy product of the errors of state i and of the sum U of
    both states, and so at most sqrt(e_ii e_UU), e the errors of F_ii and of the stiffness (AX.2). A part of it guards
    against changes that cancel in a total by chance.
    """
    changes = [total_change(b.forces - a.forces) for a, b in pairwise(history)]
    sensitivity_changes = [np.abs(b.log_sensitivity - a.log_sensitivity) for a, b in pairwise(history)]
    return SampleErrors(_remaining_error(changes) + history[-1].rounding, _remaining_error(sensitivity_changes))


def total_change(change: Floats) -> Floats:
    """How much both totals changed, shape (k, 2), from the change of F_ij, shape (k, 2, 2): see eq. AX.2."""
    single, whole = np.abs(np.diagonal(change, axis1=1, axis2=2)), np.abs(change.sum(axis=(1, 2)))[:, None]
    return np.asarray(np.maximum(np.abs(change.sum(axis=2)), GUARD * np.sqrt(single * whole)))


def _remaining_error(changes: Sequence[Floats]) -> Floats:
    """What is left after the last of several changes.

    If errors fall by q from level to level, 1 / (q - 1) of the last change is left (AX.3). No more than UNSEEN_DROP is trusted
    before a second change shows q; never less is kept than LEAST_SHARE of the last change and LEAST_MEMORY of the one before.
    """
    if len(changes) == 1:
        return np.asarray(changes[0] / (UNSEEN_DROP - 1))
    decay = np.clip(changes[-2] / np.maximum(changes[-1], 1e-300), 1.2, None)
    return np.asarray(np.maximum(changes[-1] * np.maximum(LEAST_SHARE, 1 / (decay - 1)), LEAST_MEMORY * changes[-2]))
