"""Verify designs by ``contact`` under loads beyond linear elasticity, with the load as a variable.

The objective of a design under a limit is the best of its objectives under all loads up to the limit, the linear range included.
A wider limit therefore never makes it worse. Loads are tried at ``DEPTHS_RELATIVE``, which do not depend on the limit. Where no
step converges, ``contact`` tries again with twice the contact points, as it does for a single scene.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Literal

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.common.errors import Refusal, SolveError
from geometry.common.resources import LimitReached, start_clock
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load
from probe_design.design_search.force_variable import round_load_down
from probe_design.design_search.loads import (
    BEST_LOAD,
    GAP_CLOSURE,
    LAST_CONVERGED,
    MAX_DEPTH,
    SCENE_LOAD,
    TIME_LIMIT,
    Pressing,
    compute_force,
)
from probe_design.design_search.objective_bounds import bound_objective, compute_objective
from probe_design.design_search.tumour_objective import Noise
from probe_design.design_search.verification import (
    VERIFICATION_ACCURACY,
    TumourVerification,
)
from solver.contact.evaluator import ContactEvaluator
from solver.contact.limits import CLOSED_GAP_RELATIVE, find_gap_closure_load, is_gap_closed
from solver.contact.loaded_scene import LoadedForces, LoadedScene, press_with_enough_points
from solver.contact.path import Path
from solver.contact.states import StoppedError
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
    loaded = _run_contact(design, lambda contact_scene, begin: list(_evaluate_loads(design, noise, contact_scene, begin)))
    return min((design, *loaded), key=lambda item: item.value)


def evaluate_by_contact(design: TumourVerification, noise: Noise) -> TumourVerification:
    """Return a design verified by ``contact`` under its present load; unchanged where ``contact`` fails."""
    pressing = replace(design.pressing, x=0.0, change=0.0)

    def evaluate(contact_scene: LoadedScene, begin: float) -> list[TumourVerification]:
        """Return the design under its present load as the only item of a list."""
        pressed = _press_to_load(contact_scene, pressing.load)
        return [_build_loaded_design(design, noise, *pressed, pressing=pressing, begin=begin)]

    return next(iter(_run_contact(design, evaluate)), design)


def _run_contact(
    design: TumourVerification, evaluate: Callable[[LoadedScene, float], list[TumourVerification]]
) -> list[TumourVerification]:
    """Run ``evaluate`` on a design's scene prepared for ``contact``, within the time limit; return no designs where that fails.

    Parameters
    ----------
    design
        The design.
    evaluate
        Computes designs from the scene on its meshes, still unloaded, and the time at which the run began, s.
    """
    begin = perf_counter()
    with suppress(Refusal, SolveError), start_clock(), threadpool_limits(1, user_api="blas"):
        return evaluate(ContactEvaluator().prepare_scene(design.scene, VERIFICATION_ACCURACY), begin)
    return []


def _evaluate_loads(
    design: TumourVerification, noise: Noise, contact_scene: LoadedScene, begin: float
) -> Iterator[TumourVerification]:
    """Yield a design under the largest allowed load, and under a smaller one if the objective is best there.

    Loads that ``contact`` cannot reach, and those not above the design's present one, are left out.
    """
    reach = _find_reach(contact_scene, design.scene)
    if reach.limited_by == LAST_CONVERGED and (denser := contact_scene.add_contact_points()) is not None:
        reach = max(reach, _find_reach(denser, design.scene), key=lambda item: item.max_size)
    loads = [(reach.load, reach.limited_by)]
    best = _find_interior_load(design.scene, noise, reach)
    if best is not None:
        loads.append((best, BEST_LOAD))
    for wanted, reason in loads:
        try:
            result, pressed_scene, load, limited_by = _press_within_time(reach, wanted, reason)
        except (Refusal, SolveError):
            continue
        force = float(compute_force(load, result.films.totals.sum()))
        if force > design.pressing.force:
            pressing = Pressing(load, force, x=0.0, change=0.0, limited_by=limited_by)
            yield _build_loaded_design(design, noise, result, pressed_scene, pressing=pressing, begin=begin)


@dataclass(frozen=True)
class Reach:
    """The largest load on a design, and the smaller loads solved.

    Attributes
    ----------
    contact_scene
        The scene on its meshes, with the load paths computed.
    load
        The largest allowed load.
    limited_by
        The limit that determines it.
    points
        Solutions at ``DEPTHS_RELATIVE``.
    """

    contact_scene: LoadedScene
    load: Load
    limited_by: str
    points: tuple[LoadedForces, ...]

    @property
    def quantity(self) -> Literal["force", "indentation"]:
        """The kind of the load."""
        return "force" if self.load.indentation is None else "indentation"

    @property
    def max_size(self) -> float:
        """The largest allowed load, N or m."""
        return float(getattr(self.load, self.quantity))

    @property
    def allowed_points(self) -> list[tuple[float, LoadedForces]]:
        """The solutions up to the largest load, each with its load."""
        sizes = [(float(getattr(item.point, self.quantity)), item) for item in self.points]
        return [(size, item) for size, item in sizes if size <= self.max_size]

    def build_load(self, size: float) -> Load:
        """Return a load of this kind, N or m."""
        return Load(**{self.quantity: size})


def _find_reach(contact_scene: LoadedScene, scene: Scene) -> Reach:
    """Find the largest allowed load: indent step by step until the scene's load, gap closure, or a step that fails.

    If the gap is closed where a step failed, gap closure counts as the reason. The loads of gap closure and
    of the last converged step are reduced by ``GAP_SAFETY_FACTOR``.

    Raises
    ------
    SolveError
        Not even the first step is within the time limit.
    """
    reach, points = Reach(contact_scene, scene.load, SCENE_LOAD, ()), list[LoadedForces]()
    end, limited_by = math.inf, SCENE_LOAD
    for depth in DEPTHS_RELATIVE:
        try:
            points.append(contact_scene.press_to_indentation(depth * contact_scene.paths[1].radius))
            end, limited_by = getattr(points[-1].point, reach.quantity), MAX_DEPTH
        except LimitReached:
            limited_by = TIME_LIMIT
            break
        except SolveError as fault:
            last = fault.last if isinstance(fault, StoppedError) else contact_scene.paths[1].last
            end, limited_by = GAP_SAFETY_FACTOR * getattr(last, reach.quantity), LAST_CONVERGED
        closures = [_find_path_closure(path) for path in contact_scene.paths if is_gap_closed(path)]
        if closures:
            closure = min(closures, key=lambda closing: closing.force)
            end, limited_by = GAP_SAFETY_FACTOR * getattr(closure, reach.quantity), GAP_CLOSURE
        if limited_by != MAX_DEPTH or GAP_SAFETY_FACTOR * end >= reach.max_size:
            break
    if limited_by == TIME_LIMIT and not points:
        raise SolveError("not even the first step is within the time")
    if end >= reach.max_size:
        return replace(reach, points=tuple(points))
    size = end if limited_by == TIME_LIMIT else round_load_down(end)
    return replace(reach, load=reach.build_load(size), limited_by=limited_by, points=tuple(points))


def _find_path_closure(path: Path) -> LargestLoad:
    """Return the load at which the gap closes on a load path, or the last load at which it is open if the former fails."""
    with suppress(SolveError):
        closing = find_gap_closure_load(path)
        if closing is not None:
            return closing
    last = [point for point in path.points if point.walls > CLOSED_GAP_RELATIVE * path.points[0].walls][-1]
    return LargestLoad(last.force, last.indentation, GAP_CLOSURE)


def _find_interior_load(scene: Scene, noise: Noise, reach: Reach) -> Load | None:
    """Return the load below the largest at which the standard deviation of ln E_object is minimum; None if the largest is best.

    It is the vertex of a parabola through the best load solved and both its neighbours, in the logarithms of both.
    """
    sizes = [size for size, _ in reach.allowed_points]
    values = [compute_objective(scene, item.films, noise, item.point.force) for _, item in reach.allowed_points]
    k = int(np.argmin(values)) if values else 0
    # the best is the last, the largest load, or a neighbour of the best has no value
    if k >= len(values) - 1 or not np.isfinite(values[max(0, k - 1) : k + 2]).all():
        return None
    size = sizes[k]
    if k > 0:  # else the best is the smallest load, which has no neighbour below
        a, b, _ = np.polyfit(np.log(sizes[k - 1 : k + 2]), np.log(values[k - 1 : k + 2]), 2)
        size = math.exp(-b / (2 * a)) if a > 0 else size
    return reach.build_load(round_load_down(size))


def _press_within_time(reach: Reach, load: Load, limited_by: str) -> tuple[LoadedForces, LoadedScene, Load, str]:
    """Compute a design under a load or, if the time limit is reached, return the largest load already solved.

    Returns
    -------
    tuple[LoadedForces, LoadedScene, Load, str]
        The results, the scene on the meshes used for them, the load and what limits it.
    """
    try:
        if limited_by != TIME_LIMIT:
            return *_press_to_load(reach.contact_scene, load), load, limited_by
    except LimitReached:
        if not reach.allowed_points:
            raise
    size, last = reach.allowed_points[-1]
    return last, reach.contact_scene, reach.build_load(size), TIME_LIMIT


def _press_to_load(contact_scene: LoadedScene, load: Load) -> tuple[LoadedForces, LoadedScene]:
    """Return the results of ``contact`` under a load, and the scene with as many contact points as they needed."""
    scene = contact_scene.scene.model_copy(update={"load": load})
    return press_with_enough_points(replace(contact_scene, scene=scene), LoadedScene.press_to_scene_load)


def _build_loaded_design(
    design: TumourVerification,
    noise: Noise,
    result: LoadedForces,
    pressed_scene: LoadedScene,
    *,
    pressing: Pressing,
    begin: float,
) -> TumourVerification:
    """Return a design with the results of ``contact`` under a load in place of its linear ones, which become ``linear``.

    Parameters
    ----------
    design
        The design verified within linear elasticity.
    noise
        Noise of a reading.
    result, pressed_scene
        Results under the load, and the scene on the meshes used for them.
    pressing
        The load.
    begin
        Time at which the computation began, s.
    """
    scene = design.scene.model_copy(update={"load": pressing.load})
    solution = ContactEvaluator().build_solution(scene, VERIFICATION_ACCURACY, pressed_scene, [result])
    contact_result = solution.build_result(CONTACT_EVALUATOR, scene, perf_counter() - begin)
    lower, upper = bound_objective(scene, result.films, noise, pressing)
    return replace(
        design,
        result=replace(contact_result, load_limits=design.result.load_limits),
        pressing=pressing,
        value=compute_objective(scene, result.films, noise, pressing.force),
        lower=lower,
        upper=upper,
        linear=design,
    )
