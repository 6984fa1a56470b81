"""Ratio, log-sensitivity and all that moves against load."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError, Words
from geometry.common.resources import LimitReached, timed
from geometry.scenes.probe import mm
from geometry.scenes.scene import Scene
from solver.contact.level import ContactLevel
from solver.contact.limits import closed, gap_closure_load, linear_limit_load
from solver.contact.loaded import LoadedScene
from solver.contact.path import Path
from solver.contact.pressed import Loaded, Pressed, StoppedError
from solver.results.evaluator import Tell, silent
from solver.results.load_curve import LoadCurve, LoadRange
from solver.results.result import LargestLoad
from solver.results.warnings import Note, null_sensitivity


def load_curve(scene: Scene, loads: Floats, accuracy: float, *, by_force: bool, tell: Tell = silent) -> LoadCurve:
    """Press a scene to each of several loads; see ``solver.answers.load``.

    Args:
        scene: that level ``contact`` takes; its own load does not matter.
        loads: rising, N or m, shape (k,).
        accuracy: relative.
        by_force: whether loads are forces.
        tell: called with a line before each.

    Raises:
        Refusal: the scene is of another kind, too extreme, or not even the first load converges.
        LimitReached: not even the first load is within the limits.
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
        tell("loads at which the gap closes and linear elasticity ends")
        found = ends(on, accuracy)
    return _curve(scene, points, found, stopped=stopped, accuracy=accuracy, seconds=perf_counter() - start)


@dataclass(frozen=True)
class Ends:
    """Loads at which something ends, see ``LoadCurve``, and why one is not told."""

    gap_closure_load: LargestLoad | None
    linear_limit_load: LargestLoad | None
    notes: tuple[Note, ...]


def ends_of(scene: Scene, accuracy: float) -> Ends:
    """Return the loads of a scene that level ``contact`` takes.

    Raises:
        Refusal: see ``load_curve``.
    """
    with timed(), threadpool_limits(1, user_api="blas"):
        return ends(ContactLevel().pressed(scene, accuracy), accuracy)


def ends(on: LoadedScene, accuracy: float) -> Ends:
    """Return the loads of a scene: by the finer mesh as far as that was pressed, and beyond it by the coarser."""
    closure, notes = _closure(on)
    linear = _linear_limit(on, accuracy)
    if linear is None:
        reached = f"{on.paths[0].last.force:.3g} N, as far as is known"
        notes.append(Note("linear", f"no linear_limit_load was found: linear theory holds to {accuracy:g} up to {reached}"))
    return Ends(closure, linear, tuple(notes))


def _closure(on: LoadedScene) -> tuple[LargestLoad | None, list[Note]]:
    coarse, fine = on.paths
    path = fine if closed(fine) else coarse
    why = "as deep as the probe is wide"
    try:
        found = gap_closure_load(path)
        if found is not None:
            return found, []
    except (SolveError, LimitReached) as fault:
        why = str(fault)
    state = "touch, but no step before that converges" if closed(path) else f"are apart up to {path.last.force:.3g} N"
    return None, [Note("linear", f"gap_closure_load is null: the walls {state}, {why}")]


def _linear_limit(on: LoadedScene, accuracy: float) -> LargestLoad | None:
    for path in on.paths[::-1]:

        def sensitivity(point: Pressed, path: Path = path) -> float:
            return on.sensitivity(path, point)

        with suppress(SolveError, LimitReached):
            found = linear_limit_load(path, _ratio, sensitivity, accuracy)
            if found is not None:
                return found
    return None


def _ratio(point: Pressed) -> float:
    films = point.films if point.indentation > 0 else point.tangent
    return float(films[0] / films[1])


def _curve(scene: Scene, points: list[Loaded], found: Ends, *, stopped: str | None, accuracy: float, seconds: float) -> LoadCurve:
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
        warnings.append(Note("accuracy", f"error bounds of up to {worst:.2g} reached, accuracy {accuracy:g} asked for"))
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
        gap_closure_load=found.gap_closure_load,
        linear_limit_load=found.linear_limit_load,
        constant_ratio=_constant(np.array(force), np.array(ratio), accuracy),
        accuracy=accuracy,
        stopped=stopped,
        warnings=(*warnings, *found.notes),
    )


def _constant(force: Floats, ratio: Floats, share: float) -> LoadRange | None:
    """The widest range between two of the forces in which the ratio stays within ``share``."""
    best: LoadRange | None = None
    for low in range(len(force)):
        some = ratio[low:]
        spread = np.maximum.accumulate(some) / np.minimum.accumulate(some)
        high = low + int(np.flatnonzero(spread <= (1 + share) / (1 - share))[-1])
        if high > low and (best is None or force[high] - force[low] > best.high - best.low):
            best = LoadRange(share, float(force[low]), float(force[high]))
    return best
