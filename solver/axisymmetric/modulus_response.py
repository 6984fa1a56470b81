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
from solver.axisymmetric.base_states import BaseStates, sum_products
from solver.linalg.rational_response import KrylovBasis, RationalResponse

FORCE_TOLERANCE_RELATIVE = 1e-10  # at both ends of the range; states are accurate to its root
MAX_STEPS = 60
MIN_NEW_ENERGY_SHARE = 1e-20  # outside the basis: vectors with less are dropped


@dataclass(frozen=True)
class ModulusResponse:
    """Film forces for every modulus of a body.

    With G = u_i^T K_b u_j of the states at t = 1 and c_ki = v_k^T K_b u_i of the basis, K_b v_k = l_k K v_k in it:

        F(t) = F(1) + (t - 1) G - (t - 1)^2 sum_k c_k c_k^T / (1 + (t - 1) l_k)        (AX.8)

    Attributes
    ----------
    body
        The body whose modulus varies.
    states
        Both base states u_1, u_2 at t = 1.
    edge
        The elements' values of the basis v_k on corners and edges, without rigid shifts, shape (n, 8 p, m).
    rational
        eq. AX.8, l_k, G and c.
    """

    body: Body
    states: BaseStates
    edge: Floats
    rational: RationalResponse

    def compute_forces(self, t: Floats) -> tuple[Floats, Floats]:
        """Return F and dF / d ln E for t = E / E_0 > 0, shape (n,): two arrays of shape (n, 2, 2)."""
        return self.rational.evaluate(t)

    def compute_states(self, t: Floats) -> tuple[Floats, Floats]:
        """Return coefficients of both states on (u_1, u_2, v_1 ... v_m) and their derivatives by ln E, each (n, 2 + m, 2).

        On v_k they are -(t - 1) c_k / (1 + (t - 1) l_k) and -t c_k / (1 + (t - 1) l_k)^2 (AX.9).
        """
        coefficients = np.zeros((2, len(t), 2 + len(self.rational.share), 2))
        coefficients[0, :, :2] = np.eye(2)
        coefficients[0, :, 2:], coefficients[1, :, 2:] = self.rational.compute_amplitudes(t)
        return coefficients[0], coefficients[1]

    @property
    def edges(self) -> Floats:
        """The elements' values of u_1, u_2, v_1 ... v_m on corners and edges, shape (n, 8 p, 2 + m)."""
        return np.concatenate([self.states.edge, self.edge], axis=-1)


def compute_response(states: BaseStates, low: float, high: float, body: Body = Body.INCLUSION) -> ModulusResponse:
    """Return film forces for moduli of a body from ``low`` to ``high``, as multiples of its modulus in ``states``.

    Raises
    ------
    SolveError
        The body has no elements, or the range is too wide for the tolerance.
    """
    inside = np.flatnonzero(states.model.mesh.body == body)
    if not inside.size:
        raise SolveError(f"the section has no {body.name.lower()}")
    space, ends = _BodyEnergy(states, inside), np.array([low, high])
    tolerance = max(FORCE_TOLERANCE_RELATIVE, float(np.max(states.rounding) / np.max(np.abs(states.forces))))
    forces = space.compute_forces(ends)
    for _ in range(MAX_STEPS):
        grown = space.grow()
        previous, forces = forces, space.compute_forces(ends)
        change = np.abs(forces - previous).max(axis=(1, 2)) / np.abs(forces).max(axis=(1, 2))
        if not grown or np.all(change < tolerance):
            return space.build_response(body)
    raise SolveError(f"the curve from {low:g} to {high:g} times the modulus was not found to {tolerance:.0e}")


def compute_tangent(states: BaseStates) -> ModulusResponse:
    """Return a response that is exact at t = 1 only: states and derivatives by ln E of the inclusion, from one solve."""
    space = _BodyEnergy(states, np.flatnonzero(states.model.mesh.body == Body.INCLUSION))
    space.grow()
    return space.build_response(Body.INCLUSION)


class _BodyEnergy:
    """The energies of a body on a growing basis, summed over the body's elements."""

    def __init__(self, states: BaseStates, inside: Ints) -> None:
        system = states.model.system
        size = system.stiffness.shape[1]
        self.states, self.stiffness = states, system.stiffness[inside]
        self.gather = system.numbering.gather[(inside[:, None] * size + np.arange(size)).ravel()]
        self.local = states.edge[inside]  # u_1, u_2, v_1 ... in the body
        self.newest_loads = self.stiffness @ self.local  # K_b of the newest of them
        self.energy = sum_products(self.local, self.newest_loads)
        self.basis = KrylovBasis(system.matrix, system.factor.solve, len(states.v), MIN_NEW_ENERGY_SHARE)

    def grow(self) -> bool:
        """Extend the basis by one block Krylov step, K^-1 K_b times its newest vectors, and the energies with it.

        Returns
        -------
        bool
            Whether any of the new vectors was independent of the basis; otherwise nothing changes.
        """
        new = self.basis.grow(np.asarray(self.gather.T @ self.newest_loads.reshape(-1, self.newest_loads.shape[2])))
        if not new.shape[1]:
            return False
        local = self.states.model.system.remove_shift((self.gather @ new).reshape(*self.local.shape[:2], -1))[0]
        self.newest_loads = self.stiffness @ local
        across, corner = sum_products(self.local, self.newest_loads), sum_products(local, self.newest_loads)
        self.local = np.concatenate([self.local, local], axis=2)
        self.energy = np.concatenate([np.hstack([self.energy, across]), np.hstack([across.T, corner])])
        return True

    def compute_forces(self, t: Floats) -> Floats:
        """Return film forces on the present basis, taken as orthonormal, shape (n, 2, 2)."""
        x, energy = np.asarray(t)[:, None, None] - 1, self.energy
        share, coupling = energy[2:, 2:], energy[2:, :2]
        across = coupling.T @ np.linalg.solve(
            np.eye(len(share)) + x * share, np.broadcast_to(coupling, (len(x), *coupling.shape))
        )
        return np.asarray(self.states.forces + x * energy[:2, :2] - x**2 * across)

    def build_response(self, body: Body) -> ModulusResponse:
        """Return the response on the present basis."""
        energy, edge = self.energy, self.states.model.system.compute_values(self.basis.vectors)
        rational = RationalResponse.from_energies(energy[2:, 2:], energy[2:, :2], start=self.states.forces, inside=energy[:2, :2])
        return ModulusResponse(body, self.states, edge @ rational.turn, rational)
