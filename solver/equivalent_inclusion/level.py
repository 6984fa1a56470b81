"""The evaluator ``equivalent-inclusion``: base states without tumours, then tumours by scattering (PHYSICS section 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, Words
from geometry.scenes.scene import Scene
from solver.equivalent_inclusion.ellipsoids import check as check_ellipsoids
from solver.equivalent_inclusion.ellipsoids import with_ellipsoids
from solver.equivalent_inclusion.probe_on_tissue import ProbeAlone, Undisturbed, alone, undisturbed
from solver.equivalent_inclusion.readings import Readings, readings
from solver.inclusions.tumours import Tumours
from solver.linalg.workspace import in_own_workspace
from solver.results.evaluator import Answer, FilmLevel, Tell
from solver.results.film_forces import Bound, FilmForces, shortfalls
from solver.results.kinds import crossed, needs_solid
from solver.results.result import Decision


@dataclass(frozen=True)
class EquivalentInclusion(FilmLevel):
    """Axisymmetric finite elements of probe and tissue; tumours anywhere by scattering: bonded or frictionless."""

    name: str = "equivalent-inclusion"
    summary: str = "spheres and ellipsoids anywhere; 1e-3 to 1e-2 in 0.5 s for the probe and 0.05 to 100 ms for each tumour"

    def refusal(self, scene: Scene) -> str | None:
        """Return which evaluator to use instead, and why, for scenes that this one does not model; else None."""
        return crossed(scene) or needs_solid(scene)

    def answer(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> Answer:
        """Solve the scene to first order where that is accurate enough, else with reflections.

        Raises:
            Refusal: the scene is of another kind, or so extreme that its equations cannot be solved in double precision; a curve
                of a scene with ellipsoids.
        """
        base, target, tumours = self.prepared(scene, accuracy), scene.target or 0, Tumours.of(scene)
        if moduli is None:
            read = readings(base, tumours, target, sensitive=scene.target is not None)
            read = with_ellipsoids(base, scene, read, scene.inclusion)
        else:
            if any(body.diameter is None for body in scene.inclusion):
                raise Refusal("inclusion", Words("an ellipsoid"), "spheres for a curve (evaluate takes ellipsoids)")
            read = readings(base, tumours.with_moduli(moduli, target), target, sensitive=True)
        films = tuple(film_forces(read, k, scene.target is not None) for k in range(len(read.forces)))
        worst = int(np.argmax(read.worst))
        reached = films[0].error_under(scene) if moduli is None else float(read.worst[worst])
        notes = (*base.notes, *shortfalls(films[worst], reached, accuracy, base.stopped))
        return Answer(films, base.residual, (*base.plan, *_decisions(base, read, worst)), notes)

    @in_own_workspace
    def prepared(self, scene: Scene, accuracy: float) -> Undisturbed:
        """Solve the scene's probe on its tissue without tumours.

        Raises:
            Refusal: see ``solve``.
        """
        self.check(scene)
        return undisturbed(scene, accuracy)

    @in_own_workspace
    def alone(self, scene: Scene, accuracy: float) -> ProbeAlone:
        """Compute only the film forces without tumours; many of these need little memory.

        Raises:
            Refusal: see ``solve``.
        """
        self.check(scene)
        return alone(scene, accuracy)

    def check(self, scene: Scene) -> None:
        """Raise ``Refusal`` for a scene of another kind."""
        why = self.refusal(scene)
        if why is not None:
            raise Refusal("evaluator", self.name, why)
        check_ellipsoids(scene)


def film_forces(read: Readings, k: int, target: bool) -> FilmForces:
    """Build one set's film forces with their error bounds."""
    bound = Bound(read.bound[k], float(read.log_ratio_bound[k]))
    if not target:
        return FilmForces(read.forces[k], bound)
    return FilmForces(read.forces[k], bound, read.by["youngs_modulus"][k], float(read.sensitivity_error[k]))


def _decisions(base: Undisturbed, read: Readings, k: int) -> list[Decision]:
    """Return the decision on reflections of the tumours' fields."""
    if not read.by:
        return []
    feature = "what surface, blocks and floor send back of the tumours' fields"
    effect = float(min(read.first_share[k], 1e9))
    size = f"changes the ratio by at most about {effect:.2g}"
    modelled = bool(read.reflected[k])
    reason = f"modelled: {size}" if modelled else f"left out: {size}, counted in error_estimate"
    return [Decision(feature, modelled, effect, base.accuracy, reason)]


def level(tell: Tell | None = None) -> EquivalentInclusion:
    """Return the evaluator; it reports no progress."""
    return EquivalentInclusion()
