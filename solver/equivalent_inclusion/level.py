"""Level 2: base states without tumours once, then tumours anywhere by what they scatter (PHYSICS section 4)."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from geometry.scenes.scene import Scene
from solver.equivalent_inclusion.ellipsoids import check, with_ellipsoids
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed, undisturbed
from solver.equivalent_inclusion.readings import Readings, readings
from solver.inclusions.tumours import Tumours
from solver.results.film_forces import Bound, FilmForces, checked_moduli, outputs, ratio, shortfalls
from solver.results.result import Curve, Decision, Result, needs_solid, within


@dataclass(frozen=True)
class EquivalentInclusion:
    """Axisymmetric finite elements of probe and tissue; tumours anywhere by scattering: bonded or frictionless."""

    name: str = "equivalent-inclusion"
    summary: str = "spheres and ellipsoids anywhere; 1e-3 to 1e-2 in 0.5 s for the probe and 0.05 to 100 ms for each tumour"

    def refusal(self, scene: Scene) -> str | None:
        """Say which kind of thing in the scene this level does not know, or None."""
        return needs_solid(scene)

    def evaluate_within(self, scene: Scene, accuracy: float) -> Result:
        """Answer as ``evaluate`` does, but only if every bound is below ``accuracy``.

        Raises:
            Refusal: see ``evaluate``; and where the accuracy is out of reach.
        """
        return within(*self._answer(scene, accuracy), accuracy)

    def evaluate(self, scene: Scene, accuracy: float = 0.01) -> Result:
        """Answer to first order where that is good enough, else with reflections.

        Raises:
            Refusal: the scene is of another kind, or so extreme that its equations cannot be solved in double precision.
        """
        return self._answer(scene, accuracy)[0]

    def _answer(self, scene: Scene, accuracy: float) -> tuple[Result, float]:
        start = perf_counter()
        base = self.prepared(scene, accuracy)
        found = readings(base, Tumours.of(scene), scene.target or 0, sensitive=scene.target is not None)
        found = with_ellipsoids(base, scene, found, scene.inclusion)
        films = film_forces(found, 0, scene.target is not None)
        told = outputs(scene, films) | {"residual": base.residual}
        reached = films.error_under(scene)
        warnings = (*told.pop("warnings"), *base.notes, *shortfalls(films, reached, accuracy))
        plan = (*base.plan, *_decisions(base, found, 0))
        return Result(self.name, perf_counter() - start, **told, plan=plan, warnings=warnings), reached

    def curve(self, scene: Scene, moduli: Floats, accuracy: float = 0.01) -> Curve:
        """Return ratio and log-sensitivity for every Young's modulus (Pa) of the target inclusion.

        Raises:
            InputError: there is no target, or a modulus is not positive and finite.
            Refusal: see ``evaluate``.
        """
        start, moduli = perf_counter(), checked_moduli(scene, moduli)
        target = scene.target or 0
        base = self.prepared(scene, accuracy)
        found = readings(base, Tumours.of(scene).with_moduli(moduli, target), target, sensitive=True)
        if any(body.diameter is None for body in scene.inclusion):
            raise Refusal("inclusion", Words("an ellipsoid"), "spheres for a curve (evaluate takes ellipsoids)")
        told = [ratio(scene, film_forces(found, k, True)) for k in range(len(moduli))]
        values = {key: tuple(one[key] for one in told) for key in ("ratio", "log_sensitivity", "error_estimate")}
        worst = int(np.argmax(found.worst))
        notes = (*base.notes, *shortfalls(film_forces(found, worst, True), float(found.worst[worst]), accuracy))
        plan = (*base.plan, *_decisions(base, found, worst))
        return Curve(self.name, perf_counter() - start, tuple(moduli.tolist()), **values, plan=plan, warnings=notes)

    def prepared(self, scene: Scene, accuracy: float) -> Undisturbed:
        """Return the scene's probe on its tissue without tumours, solved.

        Raises:
            Refusal: see ``evaluate``.
        """
        why = self.refusal(scene)
        if why is not None:
            raise Refusal("evaluator", self.name, why)
        check(scene)
        return undisturbed(scene, accuracy)


def film_forces(found: Readings, k: int, target: bool) -> FilmForces:
    """Return one set's film forces with their errors."""
    bound = Bound(found.bound[k], float(found.log_ratio_bound[k]))
    if not target:
        return FilmForces(found.forces[k], bound)
    return FilmForces(found.forces[k], bound, found.by["youngs_modulus"][k], float(found.sensitivity_error[k]))


def _decisions(base: Undisturbed, found: Readings, k: int) -> list[Decision]:
    """What tumours reflect, in words."""
    if not found.by:
        return []
    feature = "what surface, blocks and floor send back of the tumours' fields"
    effect = float(min(found.first_share[k], 1e9))
    size = f"changes the ratio by at most about {effect:.2g}"
    modelled = bool(found.reflected[k])
    reason = f"modelled: {size}" if modelled else f"left out: {size}, counted in error_estimate"
    return [Decision(feature, modelled, effect, base.accuracy, reason)]
