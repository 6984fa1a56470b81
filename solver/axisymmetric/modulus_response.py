"""Film forces as an exact function of one body's Young's modulus, from one factorisation.

K is affine in the modulus: with t = E / E_0, K(t) = K + (t - 1) K_b. The states at every t lie, to a stated tolerance, in the
block Krylov space of K^-1 K_b begun with the states at t = 1. On a basis of it, orthonormal in K, K_b becomes diagonal, and
the film forces a sum of rational functions of t, eq. AX.8, which is differentiated as it stands. Galerkin's
error in the forces is the square of the states' error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import SolveError
from geometry.meridian.section import Body
from solver.axisymmetric.base_states import BaseStates, products
from solver.linalg.rational_response import KrylovBasis, RationalResponse

TOLERANCE = 1e-10  # of the film forces, relative, at both ends of the range; states are good to its root
MOST_STEPS = 60
NOTHING_NEW = 1e-20  # share of a vector's energy that is left beside the basis


@dataclass(frozen=True)
class ModulusResponse:
    """Film forces for every modulus of a body.

    With G = u_i^T K_b u_j of the states at t = 1 and c_ki = v_k^T K_b u_i of the basis, K_b v_k = l_k K v_k in it:

        F(t) = F(1) + (t - 1) G - (t - 1)^2 sum_k c_k c_k^T / (1 + (t - 1) l_k)        (AX.8)

    Attributes:
        body: whose modulus varies.
        states: at t = 1.
        basis: v_k, unknowns without a lift, shape (unknowns, m).
        rational: eq. AX.8, l_k, G and c.
    """

    body: Body
    states: BaseStates
    basis: Floats
    rational: RationalResponse

    def forces(self, t: Floats) -> tuple[Floats, Floats]:
        """Return F and dF / d ln E for t = E / E_0 > 0, shape (n,): two arrays of shape (n, 2, 2)."""
        return self.rational.at(t)

    def states_at(self, t: Floats) -> tuple[Floats, Floats]:
        """Coefficients of both states on (u_1, u_2, v_1 ... v_m) and their derivatives by ln E, each (n, 2 + m, 2).

        On v_k they are -(t - 1) c_k / (1 + (t - 1) l_k) and -t c_k / (1 + (t - 1) l_k)^2 (AX.9).
        """
        both = np.zeros((2, len(t), 2 + len(self.rational.share), 2))
        both[0, :, :2] = np.eye(2)
        both[0, :, 2:], both[1, :, 2:] = self.rational.amplitudes(t)
        return both[0], both[1]

    def whole(self) -> Floats:
        """The elements' values of u_1, u_2, v_1 ... v_m, shape (n, 2 s, 2 + m)."""
        model = self.states.model
        return np.concatenate([self.states.own, model.whole(model.system.own(self.basis))], axis=-1)


def response(states: BaseStates, low: float, high: float, body: Body = Body.INCLUSION) -> ModulusResponse:
    """Return film forces for moduli of a body from ``low`` to ``high``, multiples of the one that ``states`` were solved with.

    Raises:
        SolveError: the body has no elements, or the range is too wide for the tolerance.
    """
    model = states.model
    inside = np.flatnonzero(model.mesh.body == body)
    if not inside.size:
        raise SolveError(f"the section has no {body.name.lower()}")
    space = _BodyEnergy(states, inside)
    ends = np.array([low, high])
    tolerance = max(TOLERANCE, float(np.max(states.rounding) / np.max(np.abs(states.forces))))
    curve = space.response(body)
    for _ in range(MOST_STEPS):
        before = curve.forces(ends)[0]
        grown = space.grow()
        curve = space.response(body)
        after = curve.forces(ends)[0]
        change = np.abs(after - before).max(axis=(1, 2)) / np.abs(after).max(axis=(1, 2))
        if not grown or np.all(change < tolerance):
            return curve
    raise SolveError(f"the curve from {low:g} to {high:g} times the modulus was not found to {tolerance:.0e}")


def tangent(states: BaseStates) -> ModulusResponse:
    """Return what is exact at t = 1 alone: the states and their derivatives by ln E of the inclusion, from one solve."""
    space = _BodyEnergy(states, np.flatnonzero(states.model.mesh.body == Body.INCLUSION))
    space.grow()
    return space.response(Body.INCLUSION)


class _BodyEnergy:
    """A body's energies on a growing basis: summed over its own elements."""

    def __init__(self, states: BaseStates, inside: Ints) -> None:
        self.states, self.inside, self.system = states, inside, states.model.system
        self.local = states.edge[inside]  # u_1, u_2, v_1 ... in the body
        self.last = self.system.stiffness[inside] @ self.local  # K_b of the newest of them
        self.energy = products(self.local, self.last)
        self.basis = KrylovBasis(self.system.matrix, self.system.factor.solve, len(states.v), NOTHING_NEW)

    def grow(self) -> bool:
        """Add K^-1 K_b of the newest vectors; return whether anything new came."""
        whole = np.zeros((*self.system.stiffness.shape[:2], self.last.shape[-1]))
        whole[self.inside] = self.last
        new = self.basis.grow(self.system.add_up(whole))
        if not new.shape[1]:
            return False
        local = self.system.own(new)[self.inside]
        self.last = self.system.stiffness[self.inside] @ local
        across, corner = products(self.local, self.last), products(local, self.last)
        self.local = np.concatenate([self.local, local], axis=2)
        self.energy = np.block([[self.energy, across], [across.T, corner]])
        return True

    def response(self, body: Body) -> ModulusResponse:
        """The film forces as far as the basis goes."""
        energy, forces = self.energy, self.states.forces
        rational = RationalResponse.of(energy[2:, 2:], energy[2:, :2], start=forces, inside=energy[:2, :2])
        return ModulusResponse(body, self.states, self.basis.vectors @ rational.turn, rational)
