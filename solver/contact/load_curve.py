"""Compute the film forces' ratio, log-sensitivity and other results against load."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError, Words
from geometry.common.resources import LimitReached, timed
from geometry.scenes.probe import mm
from geometry.scenes.scene import Scene
from solver.contact.level import ContactLevel
from solver.contact.limits import change_load, closed, gap_closure_load
from solver.contact.loaded import LoadedScene
from solver.contact.path import Path
from solver.contact.pressed import Loaded, Pressed, StoppedError
from solver.results.evaluator import Tell, silent
from solver.results.load_curve import LoadCurve, LoadRange
from solver.results.load_limits import LargestLoad
from solver.results.warnings import Note, null_sensitivity

LEAST_SENSITIVITY = 1e-5  # absolute tolerance of every log-sensitivity
BEYOND = 1.2  # the finer mesh is pressed this much further than the limit on the coarser one, so that its own limit lies within


def load_curve(scene: Scene, loads: Floats, accuracy: float, *, by_force: bool, tell: Tell = silent) -> LoadCurve:
    """Press a scene to each of several loads and return the curve; see ``solver.answers.load``.

    Args:
        scene: a scene that evaluator ``contact`` supports; its own load does not matter.
        loads: loads in rising order, N or m, shape (k,).
        accuracy: relative accuracy.
        by_force: whether loads are forces.
        tell: called with a line of text before each load.

    Raises:
        Refusal: the scene is not supported or too extreme, or the first load does not converge.
        LimitReached: the first load exceeds the limits of memory or time.
    """
    start = perf_counter()
    level, points, stopped = ContactLevel(), [], None
    with timed(), threadpool_limits(1, user_api="blas"):
        on = level.pressed(scene, accuracy)
        try:
            for k, load in enumerate(loads):
                tell(f"load {k + 1} of {len(loads)}, {load:.3g} {'N' if by_force else 'm'}")
                points.append(on.at_force(float(load), "force") if by_force else on.at_indentation(float(load)))
        except (StoppedError, LimitReached) as fault:
            if not points:
                if isinstance(fault, LimitReached):
                    raise
                asked = ("force", Words(f"{load:g} N")) if by_force else ("indentation", mm(float(load)))
                raise level.stopped(asked, fault) from fault
            stopped = str(fault)
    return _curve(scene, points, stopped=stopped, accuracy=accuracy, seconds=perf_counter() - start)


@dataclass(frozen=True)
class Ends:
    """Limits of the load, see ``LoadLimits``, with notes on those that are not known."""

    ratio: LargestLoad | None
    log_sensitivity: LargestLoad | None
    gap_closure: LargestLoad | None
    notes: tuple[Note, ...]


def ends_of(scene: Scene, accuracy: float) -> Ends:
    """Find the load limits of a scene that evaluator ``contact`` supports, whatever its own load is.

    They are computed on the coarser of two meshes; the lowest limit of linear elasticity is computed on the finer one too.

    Raises:
        Refusal: see ``load_curve``.
    """
    with timed(), threadpool_limits(1, user_api="blas"):
        on = ContactLevel().pressed(scene, accuracy)
        closure, notes = _closure(on)
        changes = list(_changes(on, scene, accuracy))
        found = {one.by: one.on(on.paths[0]) for one in changes}
        first = min(changes, key=lambda one: getattr(found[one.by], "force", math.inf))
        found[first.by] = _on_finer(on, first, found[first.by])
    for one in changes:
        if found[one.by] is None:
            reached = f"up to {on.paths[0].last.force:.3g} N, as far as is known"
            notes.append(Note("linear", f"{one.by} stays within {one.allowed:.2g} of linear elasticity {reached}"))
    return Ends(found["ratio"], found.get("log_sensitivity"), closure, tuple(notes))


@dataclass(frozen=True)
class _LimitChange:
    """A value that the load may change by a relative amount before linear elasticity counts as exceeded."""

    by: str
    value: Callable[[Path, Pressed], float]
    allowed: float

    def on(self, path: Path) -> LargestLoad | None:
        """Find the load on a path at which the value has changed by that; None if there is none or it cannot be narrowed down."""
        with suppress(SolveError, LimitReached):
            return change_load(path, partial(self.value, path), self.allowed, self.by)
        return None


def _changes(on: LoadedScene, scene: Scene, accuracy: float) -> Iterator[_LimitChange]:
    """Yield the values that limit linear elasticity: the ratio, and the log-sensitivity of a scene with a target."""
    yield _LimitChange("ratio", _ratio, accuracy)
    fine = on.paths[1]
    at_rest = abs(on.sensitivity(fine, fine.points[0])) if scene.target is not None else 0.0
    if at_rest:
        yield _LimitChange("log_sensitivity", on.sensitivity, max(5 * accuracy, LEAST_SENSITIVITY / at_rest))


def _on_finer(on: LoadedScene, change: _LimitChange, coarse: LargestLoad | None) -> LargestLoad | None:
    """Find a limit again on the finer mesh, pressed somewhat further; return the coarser mesh's limit if it shows none."""
    if coarse is None:
        return None
    with suppress(SolveError, LimitReached):
        on.paths[1].at_indentation(BEYOND * coarse.indentation)
    return change.on(on.paths[1]) or coarse


def _closure(on: LoadedScene) -> tuple[LargestLoad | None, list[Note]]:
    """Find the load that closes the gap, or explain in a note why none is known."""
    path = on.paths[0]
    why = "as deep as the probe is wide"
    try:
        found = gap_closure_load(path)
        if found is not None:
            return found, []
    except (SolveError, LimitReached) as fault:
        why = str(fault)
    state = "touch, but no step before that converges" if closed(path) else f"are apart up to {path.last.force:.3g} N"
    return None, [Note("linear", f"gap_closure_load is null: the walls {state}, {why}")]


def _ratio(path: Path, point: Pressed) -> float:
    """Return the ratio of the film forces at a point; at rest, that of their derivatives."""
    films = point.films if point.indentation > 0 else point.tangent
    return float(films[0] / films[1])


def _curve(scene: Scene, points: list[Loaded], *, stopped: str | None, accuracy: float, seconds: float) -> LoadCurve:
    probe = scene.probe
    areas = np.array([probe.inner_area, probe.outer_area])
    stiffness = [float(one.films.totals.sum()) for one in points]
    depth = [one.point.indentation for one in points]
    stress = np.array([one.films.totals * d / areas for one, d in zip(points, depth, strict=True)])
    ratio = [float(one.films.totals[0] / one.films.totals[1] * areas[1] / areas[0]) for one in points]
    force = [k * d for k, d in zip(stiffness, depth, strict=True)]
    warnings = [] if scene.target is not None else [null_sensitivity(len(scene.inclusion))]
    worst = max(one.films.ratio_error for one in points)
    if worst > accuracy:
        warnings.append(Note("accuracy", f"error bounds reach {worst:.2g}, above the requested accuracy of {accuracy:g}"))
    if stopped is not None:
        warnings.append(Note("limit", f"the curve ends early: {stopped}"))

    def column(name: str) -> tuple[float, ...]:
        return tuple(float(getattr(one.point, name)) for one in points)

    return LoadCurve(
        "contact",
        seconds,
        tuple(force),
        tuple(depth),
        tuple(ratio),
        tuple(one.films.log_sensitivity for one in points),
        stiffness=tuple(stiffness),
        tangent_stiffness=tuple(float(one.point.tangent.sum()) for one in points),
        stress_inner=tuple(stress[:, 0].tolist()),
        stress_outer=tuple(stress[:, 1].tolist()),
        closest_walls=column("walls"),
        contact_radius=column("contact_radius"),
        largest_strain=column("strain"),
        error_estimate=tuple(one.films.ratio_error for one in points),
        constant_ratio=_constant(np.array(force), np.array(ratio), accuracy),
        accuracy=accuracy,
        stopped=stopped,
        warnings=tuple(warnings),
    )


def _constant(force: Floats, ratio: Floats, share: float) -> LoadRange | None:
    """Find the widest range between two of the forces in which the ratio stays within ``share``, relative."""
    best: LoadRange | None = None
    for low in range(len(force)):
        some = ratio[low:]
        spread = np.maximum.accumulate(some) / np.minimum.accumulate(some)
        high = low + int(np.flatnonzero(spread <= (1 + share) / (1 - share))[-1])
        if high > low and (best is None or force[high] - force[low] > best.high - best.low):
            best = LoadRange(share, float(force[low]), float(force[high]))
    return best
