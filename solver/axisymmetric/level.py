"""Evaluator ``axisymmetric``: finite elements in the meridian plane, refined until the accuracy is reached."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Refusal, SolveError
from geometry.scenes.scene import Scene
from solver.axisymmetric.converged_forces import Converged, converged_forces
from solver.axisymmetric.shared_designs import answers
from solver.linalg.memory import keep_freed
from solver.linalg.threads import one_thread
from solver.linalg.workspace import in_own_workspace
from solver.results.evaluator import Answer, FilmLevel, Tell
from solver.results.kinds import needs_solid


@dataclass(frozen=True)
class Axisymmetric(FilmLevel):
    """High-order finite elements of the meridian plane: bonded or frictionless, one sphere on the axis at most."""

    name: str = "axisymmetric"
    summary: str = "2D finite elements; tumour on the probe's axis; 1e-4 to 1e-2 in 0.1 to 3 s"

    def refusal(self, scene: Scene) -> str | None:
        """Return why the scene is not rotationally symmetric, with the evaluator that takes it; None where it is."""
        at = scene.placement
        if needs_solid(scene) is not None:
            return needs_solid(scene)
        if len(scene.inclusion) > 1:
            return "equivalent-inclusion or closed-form for several inclusions"
        for body in scene.inclusion:
            if body.diameter is None:
                return "equivalent-inclusion or solid for an ellipsoid"
            if math.hypot(body.x - at.x, body.y - at.y) > 1e-9 * body.diameter:
                return "equivalent-inclusion or closed-form for an inclusion off the probe's axis"
        return None

    def answer(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> Answer:
        """Refine until ratio, stresses and stiffness are within ``accuracy`` and log_sensitivity within 5 times that.

        A curve takes one factorisation per mesh.

        Raises:
            Refusal: the scene is not rotationally symmetric, or its equations cannot be solved in double precision.
        """
        converged = self.converged(scene, accuracy, moduli)
        return Answer(converged.films, converged.sample.states.residual, converged.plan, converged.notes)

    @in_own_workspace
    def answers(self, scenes: Sequence[Scene], accuracies: Sequence[float]) -> list[Answer | InputError]:
        """Solve each scene at its accuracy, or return its refusal; all moduli and loads of a design are solved together."""
        return answers(self.converged, self._alone, scenes, accuracies)

    @in_own_workspace
    def converged(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> Converged:
        """Return film forces with their errors at the inclusion's modulus, or at all ``moduli``.

        Raises:
            Refusal: see ``solve``.
        """
        why = self.refusal(scene)
        if why is not None:
            raise Refusal("evaluator", self.name, why)
        keep_freed()
        with one_thread():
            try:
                return converged_forces(scene, accuracy, moduli)
            except SolveError as fault:
                if moduli is not None and "curve from" in str(fault):
                    span = f"{np.min(moduli):g} to {np.max(moduli):g} Pa"
                    raise Refusal("youngs_modulus", span, f"a narrower range ({fault})") from fault
                extremes = "scenes whose sizes and moduli lie closer together"
                raise Refusal("evaluator", self.name, f"{extremes} ({fault})") from fault


def level(tell: Tell | None = None) -> Axisymmetric:
    """Return the evaluator; it reports no progress."""
    return Axisymmetric()
