"""Film forces in three dimensions as a function of one body's Young's modulus, from the factor of one modulus.

As in ``response.py``: K(t) = K + (t - 1) K_b, t = E / E_0, and the states at all t lie in the block Krylov space of K^-1 K_b
begun with those at t = 1. On a basis v_k orthonormal in K in which K_b is diagonal, K_b v_k = l_k K v_k, with
c_kj = v_k^T K_b u_j and G_ij = u_i^T K_b u_j:

    F(t) = F(1) + (t - 1) G - (t - 1)^2 sum_k c_k c_k^T / (1 + (t - 1) l_k)                    (SO.7)

The basis grows until F no longer changes at either end of the range. Galerkin's error in F is the square of the states'.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from solver.linalg.conjugate_gradients import solve
from solver.solid.base_states import SolidStates

TOLERANCE = 1e-7  # relative, of what a step changes in the film forces; what is left is less still
MOST_STEPS = 60
NOTHING_NEW = 1e-16  # share of a vector's energy that is left beside the basis


@dataclass(frozen=True)
class SolidResponse:
    """Reactions for every modulus of a body.

    Attributes:
        states: at t = 1.
        body: whose modulus varies.
        share: l_k, the part of v_k's energy inside the body, 0 to 1, shape (m,).
        coupling: c, shape (m, 3), roots of N m.
    """

    states: SolidStates
    body: int
    share: Floats
    coupling: Floats

    def reactions(self, t: Floats) -> tuple[Floats, Floats]:
        """Reactions, as in ``SolidStates``, and their derivatives by ln E at t = E / E_0 > 0, shape (n,); twice (n, 3, 3)."""
        inside = self.states.energies[self.body]
        x = np.asarray(t, dtype=float)[:, None, None] - 1
        denominator = 1 + x[..., 0] * self.share
        products = self.states.problem.share * self.coupling[:, :, None] * self.coupling[:, None]
        total = np.einsum("nk,kij->nij", 1 / denominator, products)
        slope = np.einsum("nk,kij->nij", (2 + x[..., 0] * self.share) / denominator**2, products)
        return self.states.reactions + x * inside - x**2 * total, (x + 1) * (inside - x * slope)


def solid_response(states: SolidStates, body: int, low: float, high: float) -> SolidResponse:
    """Return reactions for moduli of a body from ``low`` to ``high``, multiples of the one that ``states`` were solved with.

    That one should be within a hundred times the tissue's, either way: begun at a million times the tissue's, 1 - l_k is lost
    to rounding (errors of 1e-4 were seen), and begun at a millionth it takes several times as many steps.

    Raises:
        SolveError: the range is too wide for the tolerance, or a system could not be solved.
    """
    space, ends = _Space(states, body), np.array([low, high])
    before = states.reactions[None]
    for _ in range(MOST_STEPS):
        grown = space.grow()
        found = space.response()
        after = found.reactions(ends)[0]
        scale = np.sqrt(np.abs(np.einsum("nii->ni", after)))
        change = np.abs(after - before) / (scale[:, :, None] * scale[:, None])
        if not grown or np.all(change[:, :2] < TOLERANCE):
            return found
        before = after
    raise SolveError(f"the curve from {low:g} to {high:g} times the modulus was not found to {TOLERANCE:.0e}")


class _Space:
    """A growing basis, orthonormal in K, with the body's energies on it."""

    def __init__(self, states: SolidStates, body: int) -> None:
        self.states, self.body, self.problem = states, body, states.problem
        own = self.problem.own(states.v, body)
        self.pushed = self._push(own)  # K_b u_1, u_2, u_3 with their lift, on all displacements
        self.last = self.problem.restricted(self.pushed)
        unknowns = len(states.v)
        self.basis, self.times, self.forced = (np.zeros((unknowns, 0)) for _ in range(3))  # v_k, K v_k, K_b v_k
        self.coupled = self.last  # K_b u_j on the unknowns

    def _push(self, own: Floats) -> Floats:
        return self.problem.solid.parts[self.body].forces(self.problem.materials[self.body], own)

    def grow(self) -> bool:
        """Add K^-1 K_b of the newest vectors; return whether anything new came."""
        problem = self.problem
        new, times = self._orthonormal(solve(problem.matrix, self.last, self.states.factor))
        if not new.shape[1]:
            return False
        self.last = problem.restricted(self._push(problem.spread(new)))
        self.basis, self.times = np.hstack([self.basis, new]), np.hstack([self.times, times])
        self.forced = np.hstack([self.forced, self.last])
        return True

    def _orthonormal(self, new: Floats) -> tuple[Floats, Floats]:
        """Make vectors orthonormal in K to the basis and each other; drop what is nothing new. Returns them and K times them."""
        matrix = self.problem.matrix
        new = new / np.sqrt(np.maximum(np.einsum("ik,ik->k", new, matrix @ new), 1e-300))
        for _ in range(2):
            new = new - self.basis @ (self.times.T @ new)
        times = matrix @ new
        gram = new.T @ times
        values, vectors = np.linalg.eigh((gram + gram.T) / 2)
        turn = vectors[:, values > NOTHING_NEW] / np.sqrt(values[values > NOTHING_NEW])
        return new @ turn, times @ turn

    def response(self) -> SolidResponse:
        """Diagonalise the body's energy on the basis."""
        inside = self.basis.T @ self.forced
        share, turn = np.linalg.eigh((inside + inside.T) / 2)
        return SolidResponse(self.states, self.body, np.clip(share, 0.0, 1.0), turn.T @ (self.basis.T @ self.coupled))
