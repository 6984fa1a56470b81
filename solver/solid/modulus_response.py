"""Compute film forces in three dimensions for any Young's modulus of one body, from the factor for one modulus.

As in the meridian plane, the stiffness is K(t) = K + (t - 1) K_b with the body's part K_b and t = E / E_0, and the states u at
all t lie in the block Krylov space of K^-1 K_b begun with those at t = 1 (``solver/linalg/rational_response.py``). On a basis v_k
orthonormal in K in which K_b is diagonal, K_b v_k = l_k K v_k, with c_kj = v_k^T K_b u_j and G_ij = u_i^T K_b u_j:

    F(t) = F(1) + (t - 1) G - (t - 1)^2 sum_k c_k c_k^T / (1 + (t - 1) l_k)                    (SO.7)

The basis grows until F no longer changes at either end of the range. Galerkin's error in F is the square of the states'.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from solver.linalg.conjugate_gradients import solve
from solver.linalg.rational_response import KrylovBasis, RationalResponse
from solver.solid.base_states import FactorisedStates, SolidStates

FORCE_TOLERANCE_RELATIVE = 1e-7  # of the film forces: change by the last step, above the remaining error
MAX_BASIS_STEPS = 60
MIN_NEW_ENERGY_SHARE = 1e-16  # of a vector's energy: new directions with less are dropped


@dataclass(frozen=True)
class SolidResponse:
    """Reactions as a function of one body's modulus.

    Attributes
    ----------
    states
        States at t = 1.
    bodies
        The bodies whose modulus varies.
    rational
        eq. SO.7, with c in roots of N m.
    """

    states: SolidStates
    bodies: tuple[int, ...]
    rational: RationalResponse

    def compute_reactions(self, t: Floats) -> tuple[Floats, Floats]:
        """Return reactions, as in ``SolidStates``, and their derivatives with respect to ln E; shape (n, 3, 3) each.

        ``t`` = E / E_0 > 0, shape (n,).
        """
        return self.rational.evaluate(t)


def compute_solid_response(states: FactorisedStates, bodies: tuple[int, ...], low: float, high: float) -> SolidResponse:
    """Compute reactions as a function of an inclusion's modulus; the bodies are its parts.

    Moduli range from ``low`` to ``high``, multiples of the modulus that ``states`` were solved with. That modulus should be
    within a factor of 100 of the tissue's: at a million times the tissue's, 1 - l_k is lost to rounding (errors of 1e-4 were
    measured), and at a millionth it takes several times as many steps.

    Raises
    ------
    SolveError
        The range is too wide for the tolerance, or a system could not be solved.
    """
    space, ends = _BodyForces(states, bodies), np.array([low, high])
    previous = states.reactions[None]
    for _ in range(MAX_BASIS_STEPS):
        grown = space.grow()
        curve = space.build_response()
        reactions = curve.compute_reactions(ends)[0]
        scale = np.sqrt(np.abs(np.einsum("nii->ni", reactions)))
        change = np.abs(reactions - previous) / (scale[:, :, None] * scale[:, None])
        if not grown or np.all(change[:, :2] < FORCE_TOLERANCE_RELATIVE):
            return curve
        previous = reactions
    raise SolveError(f"the curve from {low:g} to {high:g} times the modulus did not converge to {FORCE_TOLERANCE_RELATIVE:.0e}")


class _BodyForces:
    """Growing Krylov basis and the nodal forces of an inclusion on it."""

    def __init__(self, states: FactorisedStates, bodies: tuple[int, ...]) -> None:
        self.states, self.bodies, self.problem = states, bodies, states.problem
        self.state_forces = self.problem.restrict(
            self._apply_body_stiffness(self.problem.compute_displacements(states.v, bodies[0]))
        )  # K_b u_j on the unknowns
        self.last = self.state_forces  # K_b of the newest vectors
        unknowns = len(states.v)
        self.basis = KrylovBasis(self.problem.matrix, self._solve, unknowns, MIN_NEW_ENERGY_SHARE)
        self.basis_forces = np.zeros((unknowns, 0))  # K_b v_k

    def _apply_body_stiffness(self, displacements: Floats) -> Floats:
        """Return the inclusion's nodal forces, N, for displacements, m, (3 n, k) both."""
        parts, laws = self.problem.solid.parts, self.problem.laws
        return np.asarray(
            sum((parts[b].compute_forces(laws[b], displacements) for b in self.bodies), start=np.zeros_like(displacements))
        )

    def _solve(self, loads: Floats) -> Floats:
        """Solve the problem at t = 1 for some loads."""
        assert self.states.factor is not None  # the states at the start of a curve hold it
        return solve(self.problem.matrix, loads, self.states.factor)

    def grow(self) -> bool:
        """Extend the basis by K^-1 K_b times its newest vectors; return whether any new direction was added."""
        new = self.basis.grow(self.last)
        if not new.shape[1]:
            return False
        self.last = self.problem.restrict(self._apply_body_stiffness(self.problem.expand(new)))
        self.basis_forces = np.hstack([self.basis_forces, self.last])
        return True

    def build_response(self) -> SolidResponse:
        """Build the response on the present basis."""
        energy, coupling = (self.basis.vectors.T @ forces for forces in (self.basis_forces, self.state_forces))
        start, inside = self.states.reactions, self.states.compute_modulus_derivative(self.bodies)
        symmetric, share = (energy + energy.T) / 2, self.problem.symmetry_factor
        return SolidResponse(
            self.states,
            self.bodies,
            RationalResponse.from_energies(symmetric, coupling, start=start, inside=inside, weight=share),
        )
