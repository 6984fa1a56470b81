"""Start and best design under loads that linear elasticity does not answer for: level ``contact`` judges them."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

from geometry.common.errors import Refusal, SolveError
from geometry.common.resources import timed
from geometry.scenes.scene import Load
from probe_design.optimisation.candidate import ACCURACY, Candidate, ends_of, objective_of
from probe_design.optimisation.objective import Noise
from probe_design.optimisation.pressing import GAP, SCENE, STRAIN, Pressing, asked
from solver.contact.level import ContactLevel
from solver.contact.limits import closed, gap_closure_load
from solver.contact.loaded import LoadedScene
from solver.contact.pressed import StoppedError
from solver.results.film_forces import FilmForces

DEEPEST = 0.5  # outer radii by the linear stiffness, which level ``contact`` is held to reach
KEPT = 0.9  # of the load at which the gap closes, or beyond which no step converges: a workshop's gap is not exact
TRIES = 2


def asks_for_contact(one: Candidate) -> bool:
    """Whether a candidate is judged under less than the scene's load, and ``contact`` takes a scene of its kind."""
    return one.pressing.by != SCENE and ContactLevel().refusal(one.scene) is None


def under_load(one: Candidate, noise: Noise) -> Candidate:
    """Return a candidate judged by ``contact`` under the scene's load, or the largest that leaves its gap open if that is less.

    One that this does not press further than linear elasticity does stays as it is.
    """
    if not asks_for_contact(one):
        return one
    load, by = _aim(one)
    for _ in range(TRIES):
        scene, start = one.scene.model_copy(update={"load": load}), perf_counter()
        try:
            with timed():
                answer, on = ContactLevel().pressed_answer(scene, ACCURACY)
                force = _closure(on)
        except (Refusal, SolveError) as fault:
            force, by = _last(fault), STRAIN
        else:
            if force is None:
                result = answer.result(ContactLevel().name, scene, perf_counter() - start)
                pressed = Pressing(load, float(asked(load, answer.films[0].totals.sum())), x=0.0, change=0.0, by=by)
                return _judged(replace(one, judged=result, pressing=pressed), noise, answer.films[0])
            by = GAP
        load = Load(force=float(f"{KEPT * force:.3g}"))
        if KEPT * force <= one.pressing.force:
            break
    return one


def _aim(one: Candidate) -> tuple[Load, str]:
    """The load to begin with, and what sets it."""
    stiffness = one.judged.stiffness or 0.0
    deepest = DEEPEST * one.scene.probe.tube_radius * stiffness
    if asked(one.scene.load, stiffness) <= deepest:
        return one.scene.load, SCENE
    return Load(force=float(f"{deepest:.3g}")), STRAIN


def _last(fault: Exception) -> float:
    """The last force that was reached, N; 0 where nothing was."""
    stopped = fault.__cause__
    return stopped.last.force if isinstance(stopped, StoppedError) else 0.0


def _closure(on: LoadedScene) -> float | None:
    """The force that closes the gap, N, by the finest mesh on which it closes; None where it is open."""
    path = next((path for path in reversed(on.paths) if closed(path)), None)
    found = gap_closure_load(path) if path else None
    return found.force if found else None


def _judged(one: Candidate, noise: Noise, films: FilmForces) -> Candidate:
    """The candidate with the objective of what ``contact`` found under its load."""
    least, most = ends_of(films, noise, one.pressing)
    return replace(one, judged_objective=objective_of(films, noise, one.pressing.force), least=least, most=most)
