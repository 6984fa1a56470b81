"""Refine meshes until the accuracy is reached, and bound the remaining errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from geometry.common.resources import LimitReached
from geometry.meridian.mesh_lines import MeridianFineness
from solver.axisymmetric.sample import MeshSample
from solver.results.warnings import Note

# order, layers at corners and at last the number of cells rise together: errors fall by 3 to 10 from one to the next
MESH_LEVELS = (
    MeridianFineness(1, 2, 3),
    MeridianFineness(1, 2, 4, lean=True),
    MeridianFineness(1, 3, 5, lean=True),
    MeridianFineness(1, 3, 6, lean=True),
    MeridianFineness(1, 4, 8),
    MeridianFineness(1.5, 5, 8),
    MeridianFineness(2, 6, 8),
)
COARSE_ENOUGH = (3e-3, 3e-4)  # accuracies below which the first and the second mesh are left out
LIGHT_MESH = MeridianFineness(0.7, 1, 4, lean=True)  # tried first at low accuracy
LIGHT_MESH_MIN_ACCURACY = 3e-3  # below it the light mesh is seldom accurate enough
MAX_LIGHT_MESH_BOUND = 0.01  # wider bounds of the light mesh are not trusted: its changes may not yet fall
ONE_MESH_ORDERS = (4, 5, 6)  # orders of meshes that bound their own errors
CROSSED_SPHERE_ORDERS = (5, 6, 8)  # where interfaces cross the sphere: order 4 gave half of an error there
ASSUMED_DECAY = 1.5  # of errors from one mesh to the next, before it is measured
MIN_CHANGE_SHARE = 1.5  # smallest error bound, times the last change
CANCELLATION_GUARD = 0.3  # fraction of the largest change that eq. AX.2 allows
MIN_PREVIOUS_CHANGE_SHARE = 0.1  # smallest error bound, times the change before the last


@dataclass(frozen=True)
class SampleErrors:
    """Bounds on the errors of a sample: of its totals, shape (k, s), and of its log-sensitivities, shape (k, s / 2)."""

    totals: Floats
    sensitivity: Floats


def refine(
    solve: Callable[[MeridianFineness], MeshSample],
    accuracy: float,
    is_good: Callable[[MeshSample, SampleErrors], bool],
    one_mesh_bounds: Sequence[Callable[[MeshSample], SampleErrors | None]] = (),
    *,
    margin: float = 1.0,
    one_mesh_orders: Sequence[int] = ONE_MESH_ORDERS,
    starts_light: bool = True,
) -> tuple[MeshSample, SampleErrors, str | None]:
    """Return the first sample that is accurate enough and its error bounds, or the best that could be solved.

    The last of the three results explains why no finer mesh was used, if one was needed: a ``Note`` where a limit prevented it.
    It is None if the sample is accurate enough.

    Parameters
    ----------
    solve
        Solves on a mesh.
    accuracy
        Relative accuracy that is required; it decides on which mesh to begin.
    is_good
        Returns whether a sample with its errors is accurate enough.
    one_mesh_bounds
        Functions that bound the errors of a sample from its own mesh or return None, the cheapest first.
    margin
        Factor of error bounds from several meshes; above 1 they are used only where no mesh bounds its own errors.
    one_mesh_orders
        Orders of the meshes that can bound their own errors.
    starts_light
        Whether the light mesh is tried first where the accuracy is low.

    Raises
    ------
    SolveError
        The meshes that a first bound needs could not be solved.
    LimitReached
        They could not be solved within the limits.
    """
    history: dict[MeridianFineness, MeshSample] = {}
    best: tuple[MeshSample, SampleErrors] | None = None
    for level in _list_meshes(accuracy, bool(one_mesh_bounds), margin == 1, starts_light):
        if one_mesh_bounds and margin > 1 and level.order < min(one_mesh_orders):
            continue
        try:
            mesh_sample = solve(level)
            if level != LIGHT_MESH:
                history[level] = mesh_sample
            solved = [history[fineness] for fineness in MESH_LEVELS if fineness in history]
            # uneven meshes (margin above 1) may share an error: if one can bound its own, their differences are not used
            allowed_bounds = one_mesh_bounds if level.order in one_mesh_orders else ()
            for bounds in _iterate_bounds(
                mesh_sample, solved if margin == 1 or not allowed_bounds else [mesh_sample], allowed_bounds, margin
            ):
                finest = mesh_sample if level == LIGHT_MESH else solved[-1]
                if level == LIGHT_MESH and _compute_worst_error(finest, bounds) > MAX_LIGHT_MESH_BOUND:
                    continue
                if is_good(finest, bounds):
                    return finest, bounds, None
                if best is None or _compute_worst_error(finest, bounds) < _compute_worst_error(
                    *best
                ):  # rounding may grow from mesh to mesh
                    best = finest, bounds
        except (SolveError, LimitReached) as fault:
            if best is None:
                raise
            return *best, Note("limit", str(fault)) if isinstance(fault, LimitReached) else str(fault)
    assert best is not None  # there are more than two levels
    return *best, "this is the finest"


def _list_meshes(
    accuracy: float, has_one_mesh_bounds: bool, trusts_several: bool, starts_light: bool
) -> Sequence[MeridianFineness]:
    """Return the meshes to solve, in order, without coarse ones that are hardly ever accurate enough (``COARSE_ENOUGH``).

    Where one mesh bounds its own error (``has_one_mesh_bounds``), the second mesh comes first. If that is not accurate enough,
    and bounds from several meshes are trusted (``trusts_several``), the cheap first mesh follows and gives another bound.
    """
    levels = MESH_LEVELS[sum(accuracy < limit for limit in COARSE_ENOUGH) :]
    if not has_one_mesh_bounds:
        return levels
    light = (LIGHT_MESH,) if starts_light and accuracy >= LIGHT_MESH_MIN_ACCURACY else ()
    return (*light, levels[1], *levels[:trusts_several], *levels[2:])


def _iterate_bounds(
    mesh_sample: MeshSample,
    solved: Sequence[MeshSample],
    one_mesh_bounds: Iterable[Callable[[MeshSample], SampleErrors | None]],
    margin: float,
) -> Iterator[SampleErrors]:
    """Yield bounds on the errors of the sample on the finest mesh: from several meshes, and from that mesh alone.

    Parameters
    ----------
    mesh_sample
        The last sample that was solved; on the light mesh it is not part of ``solved``.
    solved
        Samples to compare, from the coarsest mesh to the finest.
    one_mesh_bounds, margin
        See ``refine``.
    """
    light = all(mesh_sample is not item for item in solved)
    if len(solved) > 1 and not light:
        change_bounds = bound_errors(solved)
        yield SampleErrors(margin * change_bounds.totals, margin * change_bounds.sensitivity)
    # a cheap coarser mesh, solved after the finest, gives no bound of its own
    if light or mesh_sample is solved[-1]:
        yield from (bounds for item in one_mesh_bounds if (bounds := item(mesh_sample)) is not None)


def _compute_worst_error(sample: MeshSample, bounds: SampleErrors) -> float:
    """Return the largest relative error bound of a film's force, over films and moduli."""
    return float(np.max(bounds.totals / np.maximum(np.abs(sample.totals), 1e-300)))  # 1e-300: no division by zero


def bound_errors(history: Sequence[MeshSample]) -> SampleErrors:
    """Bound the errors of the last of at least two samples by the changes between them.

    By Galerkin's orthogonality the error of film i's total is the energy product of the errors of state i and of the sum U of
    both states, and so at most sqrt(e_ii e_UU), e the errors of F_ii and of the stiffness (AX.2). A part of it guards
    against changes that cancel in a total by chance.
    """
    changes = [compute_total_change(b.products - a.products) for a, b in pairwise(history)]
    sensitivity_changes = [np.abs(b.log_sensitivities - a.log_sensitivities) for a, b in pairwise(history)]
    return SampleErrors(_extrapolate_error(changes) + history[-1].rounding, _extrapolate_error(sensitivity_changes))


def compute_total_change(change: Floats) -> Floats:
    """Return a size of the change of all totals, shape (k, s), from the change of the products, shape (k, s, 2).

    It is the change itself, or ``CANCELLATION_GUARD`` of a bound if that is larger: of a force that of eq. AX.2,
    sqrt(|dF_ii| |sum of all dF_ij|), of a charge |dQ_i1| + |dQ_i2|, as the error of a film state's own energy is not computed.
    """
    own_change, sum_change = np.abs(np.diagonal(change, axis1=1, axis2=2)), np.abs(change[:, :2].sum(axis=(1, 2)))[:, None]
    guards = np.concatenate([np.sqrt(own_change * sum_change), np.abs(change[:, 2:]).sum(axis=2)], axis=1)
    return np.asarray(np.maximum(np.abs(change.sum(axis=2)), CANCELLATION_GUARD * guards))


def _extrapolate_error(changes: Sequence[Floats]) -> Floats:
    """Bound the error that remains after the last of several changes from mesh to mesh.

    If errors fall by the factor q from mesh to mesh, 1 / (q - 1) of the last change is left (AX.3). q is ASSUMED_DECAY until a
    second change gives it. The bound is at least MIN_CHANGE_SHARE of the last change and MIN_PREVIOUS_CHANGE_SHARE of the one
    before.
    """
    if len(changes) == 1:
        return np.asarray(changes[0] / (ASSUMED_DECAY - 1))
    decay = np.clip(changes[-2] / np.maximum(changes[-1], 1e-300), 1.2, None)
    return np.asarray(
        np.maximum(changes[-1] * np.maximum(MIN_CHANGE_SHARE, 1 / (decay - 1)), MIN_PREVIOUS_CHANGE_SHARE * changes[-2])
    )
