"""Evaluator ``axisymmetric``: finite elements in the meridian plane, refined until the accuracy is reached."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal, SolveError
from geometry.scenes.scene import Scene
from solver.axisymmetric.converged_forces import Converged, compute_converged_forces
from solver.axisymmetric.shared_designs import solve_shared_designs
from solver.linalg.memory import keep_freed
from solver.linalg.workspace import use_own_workspace
from solver.results.evaluator import FilmEvaluator, FilmSolution, ProgressCallback
from solver.results.refusals import GEOMETRY_KINDS, find_refusal, is_round, refuse_unsolvable


@dataclass(frozen=True)
class Axisymmetric(FilmEvaluator):
    """Evaluate with high-order finite elements of the meridian plane: bonded or frictionless, at most one sphere on the axis."""

    name: str = "axisymmetric"
    summary: str = "2D finite elements; tumour on the probe's axis; 1e-4 to 1e-2 in 0.1 to 3 s"

    def refusal(self, scene: Scene) -> str | None:
        """Return which evaluator to use instead if the scene is not rotationally symmetric, and why; None if it is."""
        reason = find_refusal(scene, GEOMETRY_KINDS)
        if reason is not None:
            return reason
        if len(scene.inclusion) > 1:
            return "equivalent-inclusion or closed-form for several inclusions"
        if any(body.diameter is None for body in scene.inclusion):
            return "equivalent-inclusion or solid for an ellipsoid"
        return None if is_round(scene) else "equivalent-inclusion or closed-form for an inclusion off the probe's axis"

    def solve(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> FilmSolution:
        """Refine until ratio, stresses and stiffness are within ``accuracy`` and log_sensitivity within 5 times that.

        ``moduli`` are Young's moduli of the inclusion, Pa, shape (k,), or None for its own; however many they are, each mesh
        takes one factorisation.

        Raises
        ------
        Refusal
            The scene is not rotationally symmetric, or its equations cannot be solved in double precision.
        """
        converged = self.compute_converged(scene, accuracy, moduli)
        return FilmSolution(converged.films, converged.sample.states.residual, converged.plan, converged.notes)

    @use_own_workspace
    def solve_many(self, scenes: Sequence[Scene], accuracies: Sequence[float]) -> list[FilmSolution | InputError]:
        """Solve each scene at its accuracy, or return its refusal; all moduli and loads of a design are solved together."""
        return solve_shared_designs(self.compute_converged, self._solve_or_refuse, scenes, accuracies)

    @use_own_workspace
    def compute_converged(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> Converged:
        """Return film forces with their errors at the inclusion's modulus, or at all ``moduli``, Pa, shape (k,).

        Raises
        ------
        Refusal
            See ``solve``.
        """
        self.check(scene)
        keep_freed()
        with refuse_unsolvable("evaluator", self.name):
            try:
                return compute_converged_forces(scene, accuracy, moduli)
            except SolveError as fault:
                if moduli is None or "curve from" not in str(fault):
                    raise
                span = f"{np.min(moduli):g} to {np.max(moduli):g} Pa"
                raise Refusal("youngs_modulus", span, f"a narrower range ({fault})") from fault


def create_evaluator(progress: ProgressCallback | None = None) -> Axisymmetric:
    """Return the evaluator; it reports no progress."""
    return Axisymmetric()
