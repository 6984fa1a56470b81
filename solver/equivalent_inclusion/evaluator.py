"""Evaluator ``equivalent-inclusion``: base states without tumours, then tumours by scattering (PHYSICS section 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.percent import format_percent
from geometry.scenes.scene import Scene
from solver.equivalent_inclusion.ellipsoids import check_ellipsoids, correct_for_ellipsoids
from solver.equivalent_inclusion.probe_on_tissue import ProbeAlone, Undisturbed, solve_alone, solve_undisturbed
from solver.equivalent_inclusion.readings import Readings, compute_readings
from solver.inclusions.tumours import Tumours
from solver.linalg.workspace import use_own_workspace
from solver.results.evaluator import FilmEvaluator, FilmSolution, ProgressCallback
from solver.results.film_forces import Bound, FilmForces, find_shortfalls
from solver.results.refusals import GEOMETRY_KINDS, find_refusal
from solver.results.result import Decision

REFLECTIONS_FEATURE = "reflections of the tumours' fields by surface, blocks and bottom"  # name of the feature in plans


@dataclass(frozen=True)
class EquivalentInclusion(FilmEvaluator):
    """Axisymmetric finite elements of probe and tissue; tumours anywhere by scattering: bonded or frictionless."""

    name: str = "equivalent-inclusion"
    summary: str = "spheres and ellipsoids anywhere; 1e-3 to 1e-2 in 0.5 s for the probe and 0.05 to 100 ms for each tumour"

    def refusal(self, scene: Scene) -> str | None:
        """Return the reason for a refusal and the evaluator to use instead; None for scenes that this one models."""
        return find_refusal(scene, (*GEOMETRY_KINDS, "crossed sphere"))

    def solve(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> FilmSolution:
        """Solve the scene to first order where that is accurate enough, else with reflections.

        Raises
        ------
        Refusal
            The scene is of another kind, or so extreme that its equations cannot be solved in double precision.
        """
        return self.solve_readings(self.prepare(scene, accuracy), scene, accuracy, moduli)[0]

    def solve_readings(
        self, base: Undisturbed, scene: Scene, accuracy: float, moduli: Floats | None = None
    ) -> tuple[FilmSolution, Readings]:
        """Return the solution of a scene and its readings, one set for each modulus, from the ``base`` shared with others.

        Raises
        ------
        Refusal
            See ``solve``.
        """
        target, tumours = scene.target or 0, Tumours.from_scene(scene)
        if moduli is None:
            read = compute_readings(base, tumours, target, sensitive=scene.target is not None)
            read = correct_for_ellipsoids(base, scene, read)
        else:
            read = compute_readings(base, tumours.with_moduli(moduli, target), target, sensitive=True)
            for k, modulus in enumerate(moduli if any(body.diameter is None for body in scene.inclusion) else ()):
                other_scene, sets = scene.with_modulus(target, float(modulus)), np.array([k])
                read.store(sets, correct_for_ellipsoids(base, other_scene, read.select(sets)))
        films = tuple(build_film_forces(read, k, scene.target is not None) for k in range(len(read.forces)))
        errors = read.compute_max_error(scene)
        worst = int(np.argmax(errors))  # the modulus with the largest error
        reached = films[0].compute_max_error(scene) if moduli is None else float(errors[worst])
        notes = (*base.notes, *find_shortfalls(films[worst], reached, accuracy, base.stopped))
        return FilmSolution(films, base.residual, (*base.plan, *_decide_reflections(base, read, worst)), notes), read

    @use_own_workspace
    def prepare(self, scene: Scene, accuracy: float) -> Undisturbed:
        """Solve the scene's probe on its tissue without tumours.

        Raises
        ------
        Refusal
            See ``solve``.
        """
        self.check(scene)
        return solve_undisturbed(scene, accuracy)

    @use_own_workspace
    def solve_alone(self, scene: Scene, accuracy: float) -> ProbeAlone:
        """Compute only film forces and charges without tumours; many of these need little memory.

        Raises
        ------
        Refusal
            See ``solve``.
        """
        self.check(scene)
        return solve_alone(scene, accuracy)

    def check(self, scene: Scene) -> None:
        """Raise ``Refusal`` for a scene of another kind."""
        super().check(scene)
        check_ellipsoids(scene)


def build_film_forces(read: Readings, k: int, target: bool) -> FilmForces:
    """Build the film forces and charges of set k with error bounds; ``target`` says whether there is a log-sensitivity."""
    bound = Bound(read.bound[k], float(read.log_ratio_bound[k]))
    charges = None if read.charges is None else build_film_forces(read.charges, k, target)
    if not target:
        return FilmForces(read.forces[k], bound, charges=charges)
    derivative, sensitivity_error = read.derivatives["youngs_modulus"][k], float(read.sensitivity_error[k])
    return FilmForces(read.forces[k], bound, derivative, sensitivity_error, charges)


def _decide_reflections(base: Undisturbed, read: Readings, k: int) -> list[Decision]:
    """Return the decision on reflections of the tumours' fields in set k; none without tumours."""
    if not read.derivatives:
        return []
    effect = float(min(read.first_share[k], 1e9))  # may be infinite
    size = f"changes the ratio by at most about {format_percent(effect)}"
    modelled = bool(read.reflected[k])
    reason = f"modelled: {size}" if modelled else f"left out: {size}, counted in error_estimate"
    return [Decision(REFLECTIONS_FEATURE, modelled, effect, base.accuracy, reason)]


def create_evaluator(progress: ProgressCallback | None = None) -> EquivalentInclusion:
    """Return the evaluator; it reports no progress."""
    return EquivalentInclusion()
