"""A design under loads that linear elasticity does not answer for: its load is a variable, and level ``contact`` judges it.

What a design is worth under a limit is the best of what it is worth under any load up to that, the linear range included: a
wider limit makes none worse. Loads are tried at ``DEPTHS_RELATIVE``, which do not hang on the limit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.common.errors import Refusal, SolveError
from geometry.common.resources import LimitReached, timed
from geometry.scenes.scene import Load, Scene
from probe_design.optimisation.candidate import ACCURACY, Candidate, ends_of, objective_of
from probe_design.optimisation.objective import Noise
from probe_design.optimisation.pressing import BEST, DEPTH, GAP, LAST, SCENE, TIME, Pressing, asked, rounded_down
from solver.contact.level import ContactLevel
from solver.contact.limits import TOUCHED, closed, gap_closure_load
from solver.contact.loaded import LoadedScene
from solver.contact.path import Path
from solver.contact.pressed import Loaded, Pressed, StoppedError
from solver.results.load_limits import LargestLoad

STEPS = (0.1, 0.2, 0.3, 0.4, 0.5)  # outer radii deep: the last is what level ``contact`` is held to reach
KEPT = 0.9  # of the load at which the gap closes, or beyond which no step converges: a workshop's gap is not exact
CONTACT = ContactLevel().name


def asks_for_contact(one: Candidate) -> bool:
    """Whether a candidate is judged under less than the scene's load, and ``contact`` takes a scene of its kind."""
    return one.pressing.by != SCENE and ContactLevel().refusal(one.scene) is None


def under_load(one: Candidate, noise: Noise) -> Candidate:
    """Return a candidate under the best of the loads up to the scene's, those beyond linear elasticity judged by ``contact``.

    The gap is kept open. One that no load does better than the largest that linear elasticity answers for stays as it is.
    """
    if not asks_for_contact(one):
        return one
    start = perf_counter()
    try:
        with timed(), threadpool_limits(1, user_api="blas"):
            found = list(_loaded(one, noise, start))
    except (Refusal, SolveError):  # what cannot be pressed further is judged as far as linear elasticity goes
        return one
    return min((one, *found), key=lambda each: each.judged_objective)


def by_contact(one: Candidate, noise: Noise) -> Candidate:
    """Return a candidate judged by ``contact`` under the load that it has; as it is where that cannot be."""
    start = perf_counter()
    try:
        with timed(), threadpool_limits(1, user_api="blas"):
            on = ContactLevel().pressed(one.scene, ACCURACY)
            found = _at(on, one.pressing.load)
    except (Refusal, SolveError):
        return one
    return _judged(one, noise, on, found, replace(one.pressing, x=0.0, change=0.0), start=start)


def _loaded(one: Candidate, noise: Noise, start: float) -> Iterator[Candidate]:
    """Judge a candidate under the largest load that is allowed, and where less tells more under that."""
    on = ContactLevel().pressed(one.scene, ACCURACY)
    reach = _reach(on, one.scene)
    loads = [(reach.load, reach.by)]
    best = _interior(one, noise, reach)
    if best is not None:
        loads.append((best, BEST))
    for wanted, why in loads:
        try:
            found, load, by = _under(on, reach, wanted, why)
        except (Refusal, SolveError):
            continue
        force = float(asked(load, found.films.totals.sum()))
        if force > one.pressing.force:
            yield _judged(one, noise, on, found, Pressing(load, force, x=0.0, change=0.0, by=by), start=start)


def _under(on: LoadedScene, reach: Reach, load: Load, by: str) -> tuple[Loaded, Load, str]:
    """Solve under a load; if the time limit is reached, return the last smaller load solved."""
    try:
        if by != TIME:
            return _at(on, load), load, by
    except LimitReached:
        if not reach.inside:
            raise
    last = reach.inside[-1]
    size = _size(last.point, by_force=reach.by_force)
    return last, Load(force=size) if reach.by_force else Load(indentation=size), TIME


@dataclass(frozen=True)
class Reach:
    """How far a design can be pressed.

    Attributes:
        load: the largest that is allowed.
        limited_by: what sets it.
        points: on the way there, at ``DEPTHS_RELATIVE``.
    """

    load: Load
    by: str
    points: tuple[Loaded, ...]

    @property
    def by_force(self) -> bool:
        """Whether the load is a force."""
        return self.load.indentation is None

    @property
    def inside(self) -> list[Loaded]:
        """The points that are allowed."""
        most = (self.load.force if self.by_force else self.load.indentation) or 0.0
        return [point for point in self.points if _size(point.point, by_force=self.by_force) <= most]


def _reach(on: LoadedScene, scene: Scene) -> Reach:
    """Increase the indentation until the scene's load is reached with margin, the gap closes or no step converges."""
    by_force, points = scene.load.indentation is None, []
    most = float((scene.load.force if by_force else scene.load.indentation) or 0.0)
    end, by = math.inf, SCENE
    for share in STEPS:
        try:
            point = on.at_indentation(share * on.paths[1].radius)
        except SolveError as fault:
            last = fault.last if isinstance(fault, StoppedError) else on.paths[1].last
            end, by = KEPT * _size(last, by_force=by_force), LAST
        except LimitReached:
            by = TIME
            break
        else:
            points.append(point)
            end, by = _size(point.point, by_force=by_force), DEPTH
        closure = _closure(on)
        if closure is not None:
            end, by = KEPT * _size(closure, by_force=by_force), GAP
        if by != DEPTH or KEPT * end >= most:
            break
    if by == TIME and not points:
        raise SolveError("not even the first step is within the time")
    if end >= most:
        return Reach(scene.load, SCENE, tuple(points))
    size = rounded_down(end) if by != TIME else end
    return Reach(Load(force=size) if by_force else Load(indentation=size), by, tuple(points))


def _size(of: Pressed | LargestLoad, *, by_force: bool) -> float:
    return of.force if by_force else of.indentation


def _closure(on: LoadedScene) -> LargestLoad | None:
    """Return the smallest load that closes the gap on any of the meshes; None if it stays open."""
    found = [_closing(path) for path in on.paths if closed(path)]
    return min(found, key=lambda one: one.force, default=None)


def _closing(path: Path) -> LargestLoad:
    """The load that closes a path's gap; the last open point where nothing between converges."""
    with suppress(SolveError):
        found = gap_closure_load(path)
        if found is not None:
            return found
    last = [point for point in path.points if point.walls > TOUCHED * path.points[0].walls][-1]
    return LargestLoad(last.force, last.indentation, GAP)


def _interior(one: Candidate, noise: Noise, reach: Reach) -> Load | None:
    """Return the interior load of minimum objective, by a parabola through three points; None if the largest is best."""
    by_force, points = reach.by_force, reach.inside
    sizes = [_size(point.point, by_force=by_force) for point in points]
    values = [objective_of(point.films, noise, point.point.force) for point in points]
    k = int(np.argmin(values)) if values else 0
    if k >= len(values) - 1 or not np.isfinite(values[max(0, k - 1) : k + 2]).all():
        return None
    size = sizes[k]
    if k > 0:
        a, b, _ = np.polyfit(np.log(sizes[k - 1 : k + 2]), np.log(values[k - 1 : k + 2]), 2)
        size = math.exp(-b / (2 * a)) if a > 0 else size
    return Load(force=rounded_down(size)) if by_force else Load(indentation=rounded_down(size))


def _at(on: LoadedScene, load: Load) -> Loaded:
    return replace(on, scene=on.scene.model_copy(update={"load": load})).at_scene_s_load()


def _judged(one: Candidate, noise: Noise, on: LoadedScene, found: Loaded, pressed: Pressing, *, start: float) -> Candidate:
    """The candidate with the objective of what ``contact`` found under its load."""
    scene = one.scene.model_copy(update={"load": pressed.load})
    answer = ContactLevel().answer_of(scene, ACCURACY, on, found)
    result = replace(answer.result(CONTACT, scene, perf_counter() - start), load_limits=one.judged.load_limits)
    least, most = ends_of(found.films, noise, pressed)
    value = objective_of(found.films, noise, pressed.force)
    return replace(one, judged=result, pressing=pressed, judged_objective=value, least=least, most=most, linear=one)
