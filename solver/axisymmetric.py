"""Level 3: finite elements in the meridian plane, refined until the error asked for is reached."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.errors import Refusal, SolveError
from geometry.grading import Floats
from geometry.meridian import Body, Fineness, Section, Sphere, mesh
from geometry.probe import Material
from geometry.scene import Scene
from solver.base_states import BaseStates, base_states
from solver.details import details
from solver.film_forces import Bound, FilmForces, outputs
from solver.quadrilateral import elements
from solver.result import Result

# order and grading rise together: errors fall by about 5 from one level to the next
LEVELS = tuple(
    Fineness(growth, corner, order)
    for growth, corner, order in ((1.4, 0.05, 3), (1.4, 0.02, 4), (1.2, 0.008, 5), (1.0, 0.003, 6), (0.85, 0.001, 7))
)
UNSEEN_DROP = 1.4  # by which errors are trusted to fall from one level to the next before it is seen
LEAST_SHARE = 1.5  # of the last change: the least that the error bound keeps
HALF_SPACE = 1e4  # radius and depth of what stands for a half-space, in sizes of probe and inclusion


@dataclass(frozen=True)
class Axisymmetric:
    """High-order finite elements of the meridian plane: bonded or frictionless, one sphere on the axis at most."""

    name: str = "axisymmetric"
    summary: str = "2D finite elements; tumour on the probe's axis; 1e-4 to 1e-2 in 0.2 to 10 s"

    def refusal(self, scene: Scene) -> str | None:
        """Say which kind of thing in the scene is not rotationally symmetric, or None."""
        at = scene.placement
        if scene.contact.interface == "unilateral":
            return "none built yet for contact.interface = 'unilateral' (planned: contact)"
        if at.tilt != 0:
            return "none built yet for placement.tilt other than 0 (planned: solid)"
        if len(scene.inclusion) > 1:
            return "closed-form for several inclusions (planned: equivalent-inclusion, solid)"
        for body in scene.inclusion:
            if body.diameter is None:
                return "none built yet for an inclusion that is no sphere (planned: equivalent-inclusion, solid)"
            if math.hypot(body.x - at.x, body.y - at.y) > 1e-9 * body.diameter:
                return "closed-form for an inclusion off the probe's axis (planned: equivalent-inclusion, solid)"
        return None

    def evaluate_within(self, scene: Scene, accuracy: float) -> Result:
        """Answer as ``evaluate`` does, but only if every bound is below ``accuracy``.

        Raises:
            Refusal: see ``evaluate``; and where the accuracy is out of reach.
        """
        result, reached = self._answer(scene, accuracy)
        if reached > accuracy:
            raise Refusal(
                "accuracy", accuracy, f"{reached:.2g} or more for this scene (--evaluator axisymmetric answers with that error)"
            )
        return result

    def evaluate(self, scene: Scene, accuracy: float = 0.01) -> Result:
        """Refine until ratio, stresses and stiffness are within ``accuracy`` and log_sensitivity within 5 times that.

        Raises:
            Refusal: the scene is of another kind, or so extreme that its equations cannot be solved in double precision.
        """
        return self._answer(scene, accuracy)[0]

    def _answer(self, scene: Scene, accuracy: float) -> tuple[Result, float]:
        """Return the result and the largest of the bounds on ratio, stresses and stiffness."""
        start = perf_counter()
        why = self.refusal(scene)
        if why is not None:
            raise Refusal("evaluator", self.name, why)
        with threadpool_limits(1, user_api="blas"):  # many small products: more threads only wait for each other
            films, left_out = converged(scene, accuracy)
        told = outputs(scene, films)
        warnings = (*told.pop("warnings"), *left_out)
        reached = films.error_under(scene)
        if reached > accuracy:
            text = f"error bounds of {reached:.2g} reached, accuracy {accuracy:g} asked for"
            warnings = (*warnings, f"{text}: what stands in the way is listed, or finer meshes are needed")
        return Result(self.name, perf_counter() - start, **told, warnings=warnings), reached


def converged(scene: Scene, accuracy: float) -> tuple[FilmForces, list[str]]:
    """Return film forces on the first mesh that meets ``accuracy``, or on the finest, and lines on what stands in the way."""
    history: list[list[BaseStates]] = []
    found: tuple[FilmForces, list[str]] | None = None
    while True:
        try:
            history.append([_states(scene, section, LEVELS[len(history)]) for section in sections(scene)])
        except SolveError as fault:
            if found is None:
                extremes = "scenes whose sizes and moduli lie closer together"
                raise Refusal("evaluator", "axisymmetric", f"{extremes} ({fault})") from fault
            return found[0], [*found[1], f"the next finer mesh was not used: {fault}"]
        if len(history) == 1:
            continue
        films, numerical, notes = _bounded(scene, history)
        left_out = films.error_under(scene) - numerical.error_under(scene)
        small = films.error_under(scene) <= accuracy or (left_out > accuracy and numerical.error_under(scene) <= accuracy / 2)
        slope_error = _slope_error(history)
        if (small and slope_error <= 5 * accuracy) or len(history) == len(LEVELS):
            if scene.target is not None and slope_error > 5 * accuracy:
                notes.append(f"log_sensitivity is good to about {slope_error:.1g} of itself only")
            return films, notes
        found = films, notes


def sections(scene: Scene) -> tuple[Section, ...]:
    """Return the meridian sections whose film forces bracket the scene's: one if it is rotationally symmetric.

    Material added to the tissue's sides adds energy to every state, so that in the order of
    symmetric matrices F(inscribed cylinder) <= F <= F(circumscribed cylinder), eq. (A1).
    """
    tissue, at, probe = scene.tissue, scene.placement, scene.probe
    sphere = next((Sphere((body.diameter or 0.0) / 2, body.depth) for body in scene.inclusion), None)
    if tissue.shape == "cylinder":
        off = math.hypot(at.x, at.y)
        radii, depth = sorted({tissue.radius - off, tissue.radius + off}), tissue.depth
    elif tissue.shape == "block":
        x, y = abs(at.x), abs(at.y)
        radii = [min(tissue.length / 2 - x, tissue.breadth / 2 - y), math.hypot(tissue.length / 2 + x, tissue.breadth / 2 + y)]
        depth = tissue.depth
    else:
        size = max(
            probe.tube_radius, probe.core_height, probe.tube_height, 0.0 if sphere is None else sphere.radius + sphere.depth
        )
        radii, depth = [HALF_SPACE * size], HALF_SPACE * size
    section = partial(
        Section,
        probe.inner_radius,
        probe.hole_radius,
        probe.tube_radius,
        probe.core_height,
        probe.tube_height,
        tissue_depth=depth,
        sphere=sphere,
    )
    return tuple(section(tissue_radius=radius) for radius in radii)


def _states(scene: Scene, section: Section, fineness: Fineness) -> BaseStates:
    materials: dict[Body, Material] = {Body.TISSUE: scene.tissue, Body.INNER: scene.probe.inner, Body.OUTER: scene.probe.outer}
    if scene.inclusion:
        materials[Body.INCLUSION] = scene.inclusion[0]
    interface = scene.contact.interface
    assert interface != "unilateral"  # refused above
    return base_states(elements(mesh(section, fineness), fineness.order), section, materials, interface)


def _bounded(scene: Scene, history: list[list[BaseStates]]) -> tuple[FilmForces, FilmForces, list[str]]:
    """Return film forces with all their errors, the same with the meshes' errors alone, and what was left out."""
    levels = [np.mean([state.forces for state in states], axis=0) for states in history]
    forces, slope = levels[-1], np.mean([state.slope for state in history[-1]], axis=0)
    rounding = np.max([state.rounding.sum(axis=1) for state in history[-1]], axis=0)
    numerical = bound = Bound.independent(_discretisation(levels) + rounding, forces)
    left_out = []
    for name, change in _changes(scene, [state.forces for state in history[-1]], forces):
        left_out.append(f"left out: {name}, changes the ratio by at most about {change.log_ratio:.2g}, counted in error_estimate")
        bound += change
    films = FilmForces(forces, bound, slope if scene.target is not None else None)
    return films, FilmForces(forces, numerical), left_out


def _discretisation(forces: list[Floats]) -> Floats:
    """Bound on the error of the last mesh's total forces, shape (2,), eq. (A2).

    If errors fall by q from level to level, 1 / (q - 1) of the last change is left. Errors usually
    fall by 5, but no more than UNSEEN_DROP is trusted before a second change shows q, and never
    less than LEAST_SHARE of the change is kept. A tenth of the single forces' changes guards
    against changes that cancel in their sum.
    """
    changes = [np.abs(change.sum(axis=1)) + 0.1 * np.abs(change).sum(axis=1) for change in (b - a for a, b in pairwise(forces))]
    if len(changes) == 1:
        return np.asarray(changes[0] / (UNSEEN_DROP - 1))
    drop = np.clip(changes[-2] / np.maximum(changes[-1], 1e-300), 1.2, None)
    return np.asarray(np.maximum(changes[-1] * np.maximum(LEAST_SHARE, 1 / (drop - 1)), changes[-2] / 10))


def _slope_error(history: list[list[BaseStates]]) -> float:
    """Relative change of log_sensitivity by the last refinement, less the 1e-5 absolute that is always allowed."""
    coarse, fine = (FilmForces(s[0].forces, Bound(np.zeros(2), 0.0), s[0].slope).log_sensitivity or 0.0 for s in history[-2:])
    excess = abs(fine - coarse) - 1e-5
    return excess / abs(fine) if excess > 0 and fine else 0.0


def _changes(scene: Scene, bracket: list[Floats], forces: Floats) -> list[tuple[str, Bound]]:
    """Name what the meridian plane does not show and bound its change of the film forces."""
    found = [(detail.name, detail.bound(forces)) for detail in details(scene.probe)]
    if len(bracket) == 2:
        # the mean is answered: half the width would do if all went evenly between the two
        near, far = (end.sum(axis=1) for end in bracket)
        change = Bound(np.abs(far - near), float(abs(np.log(np.abs(far / near)) @ [1.0, -1.0])))
        found.append(("the tissue's sides are not round about the probe's axis", change))
    if scene.tissue.shape == "half-space":
        found.append(
            (f"the tissue beyond {HALF_SPACE:g} probe sizes", Bound(np.abs(forces.sum(axis=1)) * 4 / HALF_SPACE, 4 / HALF_SPACE))
        )
    return found
