"""Level 3: finite elements in the meridian plane, refined until the error asked for is reached."""

from __future__ import annotations

import math
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal, SolveError
from geometry.scenes.scene import Scene
from solver.axisymmetric.converged_forces import Converged, converged_forces
from solver.results.film_forces import checked_moduli, outputs, ratio
from solver.results.result import Curve, Result, needs_solid, within


@dataclass(frozen=True)
class Axisymmetric:
    """High-order finite elements of the meridian plane: bonded or frictionless, one sphere on the axis at most."""

    name: str = "axisymmetric"
    summary: str = "2D finite elements; tumour on the probe's axis; 1e-4 to 1e-2 in 0.1 to 3 s"

    def refusal(self, scene: Scene) -> str | None:
        """Say which kind of thing in the scene is not rotationally symmetric, or None."""
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

    def evaluate_within(self, scene: Scene, accuracy: float) -> Result:
        """Answer as ``evaluate`` does, but only if every bound is below ``accuracy``.

        Raises:
            Refusal: see ``evaluate``; and where the accuracy is out of reach.
        """
        return within(*self._answer(scene, accuracy), accuracy)

    def evaluate(self, scene: Scene, accuracy: float = 0.01) -> Result:
        """Refine until ratio, stresses and stiffness are within ``accuracy`` and log_sensitivity within 5 times that.

        Raises:
            Refusal: the scene is of another kind, or so extreme that its equations cannot be solved in double precision.
        """
        return self._answer(scene, accuracy)[0]

    def _answer(self, scene: Scene, accuracy: float) -> tuple[Result, float]:
        """Return the result and the largest of the bounds on ratio, stresses and stiffness."""
        start = perf_counter()
        found = self.converged(scene, accuracy)
        films = found.films[0]
        told = outputs(scene, films)
        warnings = (*told.pop("warnings"), *found.notes)
        told["residual"] = found.sample.states.residual
        return Result(self.name, perf_counter() - start, **told, plan=found.plan, warnings=warnings), films.error_under(scene)

    def curve(self, scene: Scene, moduli: Floats, accuracy: float = 0.01) -> Curve:
        """Return ratio and log-sensitivity for every Young's modulus (Pa) of the inclusion, all from one factorisation a mesh.

        Raises:
            InputError: there is no inclusion, or a modulus is not positive and finite.
            Refusal: see ``evaluate``.
        """
        start = perf_counter()
        moduli = checked_moduli(scene, moduli)
        found = self.converged(scene, accuracy, moduli)
        told = [ratio(scene, films) for films in found.films]
        values = {key: tuple(one[key] for one in told) for key in ("ratio", "log_sensitivity", "error_estimate")}
        seconds = perf_counter() - start
        return Curve(self.name, seconds, tuple(moduli.tolist()), **values, plan=found.plan, warnings=found.notes)

    def converged(self, scene: Scene, accuracy: float, moduli: Floats | None = None) -> Converged:
        """Return film forces with their errors at the inclusion's modulus, or at all ``moduli``.

        Raises:
            Refusal: see ``evaluate``.
        """
        why = self.refusal(scene)
        if why is not None:
            raise Refusal("evaluator", self.name, why)
        with threadpool_limits(1, user_api="blas"):  # many small products: more threads only wait for each other
            try:
                return converged_forces(scene, accuracy, moduli)
            except SolveError as fault:
                if moduli is not None and "curve from" in str(fault):
                    span = f"{np.min(moduli):g} to {np.max(moduli):g} Pa"
                    raise Refusal("youngs_modulus", span, f"a narrower range ({fault})") from fault
                extremes = "scenes whose sizes and moduli lie closer together"
                raise Refusal("evaluator", self.name, f"{extremes} ({fault})") from fault
