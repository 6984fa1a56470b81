"""Compute the film forces of one section on one mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from geometry.meridian.mesh_lines import Kind, MeridianFineness
from geometry.meridian.section import Body, Section
from geometry.scenes.probe import Material
from geometry.scenes.scene import Scene
from solver.axisymmetric.base_states import BaseStates, build_model, solve_base_states
from solver.axisymmetric.modulus_response import StateCurve, compute_response
from solver.axisymmetric.sections import Sections


@dataclass(frozen=True)
class MeshSample:
    """Film forces and, of films whose charges are wanted, charges at one or several moduli on one mesh.

    Attributes
    ----------
    products, product_derivatives
        ``BaseStates.products`` and their derivatives by ln E_object, shape (k, s, 2): forces F_ij, below them charges Q_ij.
    states
        The base states from which they are computed.
    modulus_ratios
        The moduli as multiples of that of ``states``, shape (k,).
    curve
        The states as functions of the modulus; None where there is one modulus.
    """

    products: Floats
    product_derivatives: Floats
    states: BaseStates
    modulus_ratios: Floats
    curve: StateCurve | None = None

    @property
    def state_curve(self) -> StateCurve:
        """The states as functions of the modulus; where there is one modulus, a curve that holds these states alone."""
        return self.curve or StateCurve(self.states.edge)

    @property
    def forces(self) -> Floats:
        """F_ij, shape (k, 2, 2)."""
        return self.products[:, :2]

    @property
    def modulus_derivative(self) -> Floats:
        """dF_ij / d ln E_object, shape (k, 2, 2)."""
        return self.product_derivatives[:, :2]

    @property
    def rounding(self) -> Floats:
        """Bound on the rounding error of each total, shape (s,)."""
        return np.asarray(self.states.rounding.sum(axis=1))

    @property
    def totals(self) -> Floats:
        """Each film's force and, below, charge (``CHARGE_UNIT``) per unit displacement of both bases, 1/m, shape (k, s)."""
        return np.asarray(self.products.sum(axis=2))

    @property
    def log_sensitivities(self) -> Floats:
        """Derivatives of ln(inner / outer total) by ln E_object, of forces and of charges, (k, 1) or (k, 2).

        A total of zero counts as constant.
        """
        totals = self.totals
        films = np.divide(self.product_derivatives.sum(axis=2), totals, out=np.zeros_like(totals), where=totals != 0)
        return np.asarray(films[:, ::2] - films[:, 1::2])


def solve_on_mesh(
    section: Section,
    scene_sections: Sections,
    scene: Scene,
    fineness: MeridianFineness,
    *,
    moduli: Floats | None = None,
    kind: Kind | None = None,
) -> MeshSample:
    """Solve one section on one mesh, at the inclusion's modulus or at all ``moduli``.

    Parameters
    ----------
    section
        The section to solve: that of ``scene_sections`` or a variant of it, as with another tissue radius.
    scene_sections
        Supply the materials.
    scene
        Supplies the contact and the inclusion.
    fineness
        Of the mesh.
    moduli
        Young's moduli of the inclusion, Pa, shape (k,); None for its own.
    kind
        Topology of the mesh; None for that which fits the section.

    Raises
    ------
    SolveError
        The equations cannot be solved in double precision.
    """
    materials, interface = dict(scene_sections.materials), scene.contact.interface
    assert interface != "unilateral"  # refused before
    if moduli is not None:
        middle = _choose_middle_modulus(moduli, scene.tissue.youngs_modulus)
        materials[Body.INCLUSION] = Material(youngs_modulus=middle, poisson_ratio=scene.inclusion[0].poisson_ratio)
    try:
        states = solve_base_states(build_model(section, materials, interface, fineness, kind=kind, films=scene_sections.films))
    except np.linalg.LinAlgError as fault:  # Poisson's ratio within rounding of 1/2
        raise SolveError(f"an element's matrix cannot be inverted: {fault}") from fault
    if moduli is None:
        derivative = states.compute_modulus_derivative() if scene.inclusion else np.zeros_like(states.products)
        return MeshSample(states.products[None], derivative[None], states, np.ones(1))
    modulus_ratios = moduli / middle
    response, states_by_modulus = compute_response(states, modulus_ratios.min(), modulus_ratios.max())
    return MeshSample(*response.evaluate(modulus_ratios), states, modulus_ratios, states_by_modulus)


def _choose_middle_modulus(moduli: Floats, tissue_modulus: float) -> float:
    """Return the modulus at which a curve is solved, Pa: the geometric mean of the range in which the film forces change.

    Beyond a hundredth and a hundred times the tissue's modulus the inclusion is nearly a hole or nearly rigid.
    """
    low, high = np.clip([moduli.min(), moduli.max()], 0.01 * tissue_modulus, 100 * tissue_modulus)
    return float(np.sqrt(low * high))
