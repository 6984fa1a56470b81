"""Wrap the finite-element evaluators as casadi functions with exact Jacobians, for design optimisation by IPOPT."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.common.arrays import Floats
from geometry.common.errors import ProbeError, Refusal
from geometry.meridian.mesh_lines import Kind, MeshTopology
from geometry.scenes.base_sizes import find_base_sizes
from geometry.scenes.scene import Scene
from geometry.scenes.units import SI_CONTEXT
from solver.axisymmetric.evaluator import Axisymmetric
from solver.axisymmetric.gradients import Gradients, compute_gradients
from solver.axisymmetric.sample import solve_on_mesh
from solver.axisymmetric.sections import Sections, add_details, build_sections
from solver.casadi_functions.base import DifferentiableFunction
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.gradients import compute_tumour_gradients, solve_first_order
from solver.results.result import Decision

STRESS_OUTPUTS = ("ratio", "stress_inner", "stress_outer", "log_sensitivity")
"""Outputs for scenes that read stresses."""
CHARGE_OUTPUTS = (
    "charge_ratio", "stress_inner", "stress_outer", "charge_log_sensitivity", "charge_inner", "charge_outer",
)  # fmt: skip
"""Outputs for scenes that read charges: ratio and log-sensitivity are those of the charges, which follow them."""


class FilmCallback(DifferentiableFunction):
    """Ratio, stresses, log-sensitivity and charges of a scene as functions of some of its numbers x, SI.

    ``output_names`` lists them: ``STRESS_OUTPUTS``, or ``CHARGE_OUTPUTS`` where the scene reads charges.

    The mesh that meets the accuracy at the scene itself is used throughout: its nodes move smoothly with x, and so do the
    outputs. A design that does not fit this mesh gets a mesh of its own kind. An invalid scene, or one that cannot be solved,
    gives NaN, from which IPOPT steps back.

    Parameters
    ----------
    scene
        Where x starts; of a kind that ``axisymmetric`` takes.
    variables
        Keys of ``geometry.scenes.variables.list_values``.
    accuracy
        Of the outputs at the scene itself, see ``solver.evaluate``.

    Raises
    ------
    InputError
        A variable is not one of the scene's.
    Refusal
        ``axisymmetric`` cannot take the scene, or a charge that it reads is not known.
    """

    def __init__(self, scene: Scene, variables: tuple[str, ...], accuracy: float = 0.01) -> None:
        super().__init__()
        self.scene, self.variables = _write_defaults(scene), variables
        layout, plan = self.solve_start(accuracy)
        self.kind, self.fineness = layout.kind, layout.fineness
        self.layered = any(decision.modelled for decision in plan)
        self.begin("films", len(variables), len(self.output_names))

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs, in their order."""
        return CHARGE_OUTPUTS if self.scene.observable == "charge" else STRESS_OUTPUTS

    def solve_start(self, accuracy: float) -> tuple[MeshTopology, tuple[Decision, ...]]:
        """Solve the scene itself and check the variables; return the mesh and the plan of details."""
        start = Axisymmetric().compute_converged(self.scene, accuracy)
        self.check_outputs(compute_gradients(self.scene, start.sample, self.variables))
        return start.sample.states.model.mesh.layout, start.plan

    def check_outputs(self, gradients: Gradients) -> None:
        """Raise ``Refusal`` where the gradients lack an output: those of the charges that the scene reads."""
        if not set(self.output_names) <= set(gradients.values):
            raise Refusal("reading.observable", "charge", "'stress' for derivatives that leave out the charges")

    def differentiate(self, scene: Scene, scene_sections: Sections, kind: Kind | None) -> Gradients:
        """Return the outputs and derivatives of one design, on a mesh of the given kind; of its own where ``kind`` is None.

        Raises
        ------
        ProbeError
            The design cannot be solved on that mesh.
        """
        mesh_sample = solve_on_mesh(scene_sections.section, scene_sections, scene, self.fineness, kind=kind)
        return compute_gradients(scene, mesh_sample, self.variables)

    def compute(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the outputs and their derivatives at x; NaN where the scene is invalid or cannot be solved."""
        solution, names = self._try_differentiate(x), self.output_names
        if solution is None:
            return np.full(len(names), np.nan), np.full((len(names), len(x)), np.nan)
        return np.array([solution.values[name][0] for name in names]), np.array([solution.derivatives[name][0] for name in names])

    def _try_differentiate(self, x: Floats) -> Gradients | None:
        """Return the outputs and derivatives at x; None where the scene is invalid or cannot be solved.

        The mesh of the scene at the start is tried first, so that the outputs are smooth, then one that fits the design.
        """
        try:
            scene = self.scene.replace(dict(zip(self.variables, x.tolist(), strict=True)))
            scene_sections = build_sections(scene)
        except (ProbeError, ValueError):
            return None
        if self.layered:
            scene_sections = add_details(scene, scene_sections)
        for kind in (self.kind, None):
            try:
                with threadpool_limits(1, user_api="blas"):
                    return self.differentiate(scene, scene_sections, kind)
            except ProbeError:
                continue
        return None


class TumourCallback(FilmCallback):
    """Outputs as of ``FilmCallback``, for scenes with spheres anywhere, by the evaluator ``equivalent-inclusion`` to first order.

    Reflections are left out, as they have no exact derivative: verify designs from IPOPT with reflections.

    Raises
    ------
    InputError
        A variable is not one of the scene's.
    Refusal
        The evaluator cannot take the scene.
    """

    def solve_start(self, accuracy: float) -> tuple[MeshTopology, tuple[Decision, ...]]:
        """Solve the scene itself and check the variables, to first order; see ``FilmCallback.solve_start``."""
        base = EquivalentInclusion().prepare(self.scene, accuracy)
        first_order = solve_first_order(self.scene, build_sections(self.scene))
        self.check_outputs(compute_tumour_gradients(self.scene, first_order, self.variables))
        return base.field.states.model.mesh.layout, base.plan

    def differentiate(self, scene: Scene, scene_sections: Sections, kind: Kind | None) -> Gradients:
        """Return the outputs and derivatives of one design, on a mesh of the given kind; of its own where ``kind`` is None.

        Raises
        ------
        ProbeError
            The design cannot be solved on that mesh.
        """
        EquivalentInclusion().check(scene)
        return compute_tumour_gradients(scene, solve_first_order(scene, scene_sections, self.fineness, kind), self.variables)


def _write_defaults(scene: Scene) -> Scene:
    """Return the scene with those defaults written out that are computed from other numbers of the scene.

    They are the sizes of the base; written out, they stay constant as x changes the others.
    """
    data, probe = scene.model_dump(exclude_unset=True), scene.probe
    if probe.base.youngs_modulus is not None:
        data["probe"]["base"] |= asdict(find_base_sizes(probe))
    return Scene.model_validate(data, context=SI_CONTEXT)
