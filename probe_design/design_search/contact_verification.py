"""Verify designs by ``contact`` under loads beyond linear elasticity, with the load as a variable.

The objective of a design under a limit is the best of its objectives under all loads up to the limit, the linear range included.
A wider limit therefore never makes it worse. Loads are tried at ``DEPTHS_RELATIVE``, which do not depend on the limit.
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
from geometry.common.resources import LimitReached, start_clock
from geometry.scenes.scene import Load, Scene
from probe_design.design_search.loads import (
    BEST_LOAD,
    GAP_CLOSURE,
    LAST_CONVERGED,
    MAX_DEPTH,
    SCENE_LOAD,
    TIME_LIMIT,
    Pressing,
    compute_force,
    round_load_down,
)
from probe_design.design_search.tumour_objective import Noise
from probe_design.design_search.verification import (
    VERIFICATION_ACCURACY,
    TumourVerification,
    bound_objective,
    compute_objective,
)
from solver.contact.evaluator import ContactEvaluator
from solver.contact.limits import CLOSED_GAP_RELATIVE, find_gap_closure_load, is_gap_closed
from solver.contact.loaded_scene import LoadedForces, LoadedScene
from solver.contact.path import Path
from solver.contact.states import PathPoint, StoppedError
from solver.results.load_limits import LargestLoad

DEPTHS_RELATIVE = (0.1, 0.2, 0.3, 0.4, 0.5)  # indentations over the outer radius; ``contact`` is required to reach the last
GAP_SAFETY_FACTOR = 0.9  # of the load at which the gap closes or the last step converges, since a manufactured gap is not exact
CONTACT_EVALUATOR = ContactEvaluator().name


def needs_contact(design: TumourVerification) -> bool:
    """Return whether a design is verified below the scene's load although ``contact`` can model its scene."""
    return design.pressing.limited_by != SCENE_LOAD and ContactEvaluator().refusal(design.scene) is None


def optimize_load(design: TumourVerification, noise: Noise) -> TumourVerification:
    """Return a design under its best load up to the scene's; ``contact`` evaluates loads beyond linear elasticity.

    The gap is kept open. A design is returned unchanged if no load is better than the largest within linear elasticity.
    """
    if not needs_contact(design):
        return design
    start = perf_counter()
    try:
        with start_clock(), threadpool_limits(1, user_api="blas"):
            loaded = list(_evaluate_loads(design, noise, start))
    except (Refusal, SolveError):  # a design that cannot be pressed further stays verified within linear elasticity
        return design
    return min((design, *loaded), key=lambda item: item.value)


def evaluate_by_contact(design: TumourVerification, noise: Noise) -> TumourVerification:
    """Return a design verified by ``contact`` under its present load; unchanged where ``contact`` fails."""
    start = perf_counter()
    try:
        with start_clock(), threadpool_limits(1, user_api="blas"):
            contact_scene = ContactEvaluator().prepare_scene(design.scene, VERIFICATION_ACCURACY)
            loaded = _solve_at_load(contact_scene, design.pressing.load)
    except (Refusal, SolveError):
        return design
    return _build_loaded_design(design, noise, contact_scene, loaded, replace(design.pressing, x=0.0, change=0.0), start=start)


def _evaluate_loads(design: TumourVerification, noise: Noise, start: float) -> Iterator[TumourVerification]:
    """Evaluate a design under the largest allowed load, and under a smaller one where that has a better objective."""
    contact_scene = ContactEvaluator().prepare_scene(design.scene, VERIFICATION_ACCURACY)
    reach = _find_reach(contact_scene, design.scene)
    loads = [(reach.load, reach.limited_by)]
    best = _find_interior_load(design, noise, reach)
    if best is not None:
        loads.append((best, BEST_LOAD))
    for wanted, reason in loads:
        try:
            loaded, load, limited_by = _solve_load(contact_scene, reach, wanted, reason)
        except (Refusal, SolveError):
            continue
        force = float(compute_force(load, loaded.films.totals.sum()))
        if force > design.pressing.force:
            yield _build_loaded_design(
                design,
                noise,
                contact_scene,
                loaded,
                Pressing(load, force, x=0.0, change=0.0, limited_by=limited_by),
                start=start,
            )


def _solve_load(contact_scene: LoadedScene, reach: Reach, load: Load, limited_by: str) -> tuple[LoadedForces, Load, str]:
    """Solve under a load; if the time limit is reached, return the last smaller load solved."""
    try:
        if limited_by != TIME_LIMIT:
            return _solve_at_load(contact_scene, load), load, limited_by
    except LimitReached:
        if not reach.allowed_points:
            raise
    last = reach.allowed_points[-1]
    size = _get_load_size(last.point, by_force=reach.is_force)
    return last, Load(force=size) if reach.is_force else Load(indentation=size), TIME_LIMIT


@dataclass(frozen=True)
class Reach:
    """The largest load on a design, and the smaller loads solved.

    Attributes
    ----------
    load
        The largest allowed load.
    limited_by
        The limit that determines it.
    points
        Solutions up to this load, at ``DEPTHS_RELATIVE``.
    """

    load: Load
    limited_by: str
    points: tuple[LoadedForces, ...]

    @property
    def is_force(self) -> bool:
        """Whether the load is a force."""
        return self.load.indentation is None

    @property
    def allowed_points(self) -> list[LoadedForces]:
        """The points that are allowed."""
        max_size = (self.load.force if self.is_force else self.load.indentation) or 0.0
        return [point for point in self.points if _get_load_size(point.point, by_force=self.is_force) <= max_size]


def _find_reach(contact_scene: LoadedScene, scene: Scene) -> Reach:
    """Increase the indentation until the scene's load is reached with margin, the gap closes or no step converges."""
    by_force, points = scene.load.indentation is None, []
    scene_size = float((scene.load.force if by_force else scene.load.indentation) or 0.0)
    end, limited_by = math.inf, SCENE_LOAD
    for share in DEPTHS_RELATIVE:
        try:
            point = contact_scene.press_to_indentation(share * contact_scene.paths[1].radius)
        except SolveError as fault:
            last = fault.last if isinstance(fault, StoppedError) else contact_scene.paths[1].last
            end, limited_by = GAP_SAFETY_FACTOR * _get_load_size(last, by_force=by_force), LAST_CONVERGED
        except LimitReached:
            limited_by = TIME_LIMIT
            break
        else:
            points.append(point)
            end, limited_by = _get_load_size(point.point, by_force=by_force), MAX_DEPTH
        closure = _find_closure(contact_scene)
        if closure is not None:
            end, limited_by = GAP_SAFETY_FACTOR * _get_load_size(closure, by_force=by_force), GAP_CLOSURE
        if limited_by != MAX_DEPTH or GAP_SAFETY_FACTOR * end >= scene_size:
            break
    if limited_by == TIME_LIMIT and not points:
        raise SolveError("not even the first step is within the time")
    if end >= scene_size:
        return Reach(scene.load, SCENE_LOAD, tuple(points))
    size = round_load_down(end) if limited_by != TIME_LIMIT else end
    return Reach(Load(force=size) if by_force else Load(indentation=size), limited_by, tuple(points))


def _get_load_size(load_point: PathPoint | LargestLoad, *, by_force: bool) -> float:
    return load_point.force if by_force else load_point.indentation


def _find_closure(contact_scene: LoadedScene) -> LargestLoad | None:
    """Return the smallest load that closes the gap on any of the meshes; None if it stays open."""
    closures = [_find_path_closure(path) for path in contact_scene.paths if is_gap_closed(path)]
    return min(closures, key=lambda closing: closing.force, default=None)


def _find_path_closure(path: Path) -> LargestLoad:
    """Return the load that closes the gap on a path; that of the last open point if no point beyond it converges."""
    with suppress(SolveError):
        closing = find_gap_closure_load(path)
        if closing is not None:
            return closing
    last = [point for point in path.points if point.walls > CLOSED_GAP_RELATIVE * path.points[0].walls][-1]
    return LargestLoad(last.force, last.indentation, GAP_CLOSURE)


def _find_interior_load(design: TumourVerification, noise: Noise, reach: Reach) -> Load | None:
    """Return the interior load of minimum objective, by a parabola through three points; None if the largest is best."""
    by_force, points = reach.is_force, reach.allowed_points
    sizes = [_get_load_size(point.point, by_force=by_force) for point in points]
    values = [compute_objective(point.films, noise, point.point.force) for point in points]
    k = int(np.argmin(values)) if values else 0
    if k >= len(values) - 1 or not np.isfinite(values[max(0, k - 1) : k + 2]).all():
        return None
    size = sizes[k]
    if k > 0:
        a, b, _ = np.polyfit(np.log(sizes[k - 1 : k + 2]), np.log(values[k - 1 : k + 2]), 2)
        size = math.exp(-b / (2 * a)) if a > 0 else size
    return Load(force=round_load_down(size)) if by_force else Load(indentation=round_load_down(size))


def _solve_at_load(contact_scene: LoadedScene, load: Load) -> LoadedForces:
    return replace(contact_scene, scene=contact_scene.scene.model_copy(update={"load": load})).press_to_scene_load()


def _build_loaded_design(
    design: TumourVerification, noise: Noise, contact_scene: LoadedScene, loaded: LoadedForces, pressed: Pressing, *, start: float
) -> TumourVerification:
    """Return the design with the objective of the results of ``contact`` under its load."""
    scene = design.scene.model_copy(update={"load": pressed.load})
    answer = ContactEvaluator().build_answer(scene, VERIFICATION_ACCURACY, contact_scene, loaded)
    result = replace(answer.build_result(CONTACT_EVALUATOR, scene, perf_counter() - start), load_limits=design.result.load_limits)
    lower, upper = bound_objective(loaded.films, noise, pressed)
    value = compute_objective(loaded.films, noise, pressed.force)
    return replace(
        design,
        result=result,
        pressing=pressed,
        value=value,
        lower=lower,
        upper=upper,
        linear=design,
    )
