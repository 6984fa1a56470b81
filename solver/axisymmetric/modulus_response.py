"""Compute film forces as an exact function of one body's Young's modulus, from one factorisation.

K is affine in the modulus: with t = E / E_0, K(t) = K + (t - 1) K_b. The states at every t lie, to a stated tolerance, in the
block Krylov space of K^-1 K_b begun with the states at t = 1. On a basis of it, orthonormal in K, K_b becomes diagonal, and
the film forces a sum of rational functions of t, eq. AX.8, which is differentiated analytically. Galerkin's
error in the forces is the square of the states' error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import SolveError
from geometry.meridian.section import Body
from solver.axisymmetric.base_states import BaseStates
from solver.linalg.rational_response import BodySpace, RationalResponse

FORCE_TOLERANCE_RELATIVE = 1e-10  # at both ends of the range; states are accurate to its root
MAX_STEPS = 60
MIN_NEW_ENERGY_SHARE = 1e-20  # outside the basis: vectors with less are dropped


@dataclass(frozen=True)
class StateCurve:
    """The s states as functions of a body's modulus, t = E / E_0.

    With G = u_i^T K_b u_j of the states at t = 1 and c_ki = v_k^T K_b u_i of the basis, K_b v_k = l_k K v_k in it:

        F(t) = F(1) + (t - 1) G - (t - 1)^2 sum_k c_k c_k^T / (1 + (t - 1) l_k)        (AX.8)

    Attributes
    ----------
    edges
        The elements' values of the states u_1 ... u_s at t = 1 and of the basis v_1 ... v_m on corners and edges, without rigid
        shifts, shape (n, 8 p, s + m).
    rational
        eq. AX.8, l_k, G and c; None for one modulus, t = 1, and no basis.
    """

    edges: Floats
    rational: RationalResponse | None = None

    @property
    def count(self) -> int:
        """The number of states s."""
        return int(self.edges.shape[2] if self.rational is None else self.rational.coupling.shape[1])

    def compute_states(self, t: Floats) -> tuple[Floats, Floats]:
        """Return coefficients of the states on (u_1 ... u_s, v_1 ... v_m) and their derivatives by ln E, each (n, s + m, s).

        ``t`` are n moduli relative to that of the solved states, E / E_0.
        On v_k they are -(t - 1) c_k / (1 + (t - 1) l_k) and -t c_k / (1 + (t - 1) l_k)^2 (AX.9).
        """
        coefficients = np.zeros((2, len(t), self.edges.shape[2], self.count))
        coefficients[0, :, : self.count] = np.eye(self.count)
        if self.rational is not None:
            coefficients[0, :, self.count :], coefficients[1, :, self.count :] = self.rational.compute_amplitudes(t)
        return coefficients[0], coefficients[1]


def compute_response(
    states: BaseStates, low: float, high: float, body: Body = Body.INCLUSION
) -> tuple[RationalResponse, StateCurve]:
    """Return products and states for moduli of a body from ``low`` to ``high``, as multiples of its modulus in ``states``.

    The products are those of ``BaseStates.products``, shape (k, s, 2) at k moduli.
    The basis grows step by step until the film forces at both ends of the range change by less than the tolerance.

    Raises
    ------
    SolveError
        The body has no elements, or the range is too wide for the tolerance.
    """
    inside = np.flatnonzero(states.model.mesh.body == body)
    if not inside.size:
        raise SolveError(f"the section has no {body.name.lower()}")
    space, ends = _build_space(states, inside), np.array([low, high])
    tolerance = max(FORCE_TOLERANCE_RELATIVE, float(np.max(states.rounding[:2]) / np.max(np.abs(states.forces))))
    inside_energy = states.compute_modulus_derivative(body)
    forces = space.build_response(states.products, inside_energy).evaluate(ends)[0][:, :2]
    for _ in range(MAX_STEPS):
        grown = space.grow()
        response = space.build_response(states.products, inside_energy)
        previous, forces = forces, response.evaluate(ends)[0][:, :2]
        change = np.abs(forces - previous).max(axis=(1, 2)) / np.abs(forces).max(axis=(1, 2))
        if not grown or np.all(change < tolerance):
            return response, _build_curve(states, space, response)
    raise SolveError(f"the curve from {low:g} to {high:g} times the modulus was not found to {tolerance:.0e}")


def compute_tangent(states: BaseStates) -> StateCurve:
    """Return a curve that is exact at t = 1 only: the states there and their derivatives by ln E of the inclusion.

    It takes one solve with the factorised stiffness.
    """
    space = _build_space(states, np.flatnonzero(states.model.mesh.body == Body.INCLUSION))
    space.grow()
    return _build_curve(states, space, space.build_response(states.products, states.compute_modulus_derivative()))


def _build_space(states: BaseStates, inside: Ints) -> BodySpace:
    """Return the space of K^-1 K_b with the elements ``inside`` of a body, before its first step."""
    system = states.model.system
    size, stiffness = system.stiffness.shape[1], system.stiffness[inside]
    gather = system.numbering.take_gather_rows(inside)

    def assemble_loads(local: Floats) -> Floats:
        """Return the forces K_b u on the unknowns, shape (unknowns, k), from values of the body's e elements, (e, 8 p, k)."""
        return np.asarray(gather.T @ (stiffness @ local).reshape(-1, local.shape[2]))

    def multiply_body(v: Floats) -> Floats:
        """Return the forces K_b v for displacements v of the unknowns, shape (unknowns, k) both."""
        return assemble_loads(system.remove_shift((gather @ v).reshape(len(inside), size, -1))[0])

    return BodySpace(system.matrix, system.factor.solve, multiply_body, assemble_loads(states.edge[inside]), MIN_NEW_ENERGY_SHARE)


def _build_curve(states: BaseStates, space: BodySpace, response: RationalResponse) -> StateCurve:
    """Return the curve of states, with the basis turned to the vectors v_k of eq. AX.8, on which K_b is diagonal."""
    basis = states.model.system.compute_values(space.vectors) @ response.turn
    return StateCurve(np.concatenate([states.edge, basis], axis=2), response)
