"""Solve with a matrix that is linear in a number t, K(t) = K + (t - 1) B, for every t from one factor of K.

Solutions u(t) of given loads lie, to a stated tolerance, in the block Krylov space of K^-1 B begun with B u(1). On a basis of it
that is orthonormal in K, B is made diagonal, and products of the solutions become sums of rational functions of t.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from geometry.common.arrays import Floats


class BodySpace:
    """A growing basis, orthonormal in K, of the block Krylov space of K^-1 B begun with B u(1), and B on it.

    Parameters
    ----------
    matrix
        K, shape (n, n), symmetric and positive definite: any object that multiplies arrays (n, k) by ``@``.
    solve
        Function that returns K^-1 loads, shape (n, k) both.
    multiply_body
        Function that returns B times vectors, shape (n, k) both; B is the part of K of one body.
    state_loads
        B u_i of the solutions at t = 1, shape (n, k).
    negligible
        Fraction of its energy that a new vector must have outside the basis; otherwise it is dropped.

    Attributes
    ----------
    vectors
        The basis: v_k by columns, shape (n, m).
    """

    def __init__(
        self,
        matrix: Any,
        solve: Callable[[Floats], Floats],
        multiply_body: Callable[[Floats], Floats],
        state_loads: Floats,
        negligible: float,
    ) -> None:
        """Begin with an empty basis."""
        self._matrix, self._solve, self._multiply_body, self._negligible = matrix, solve, multiply_body, negligible
        self._state_loads = state_loads
        self._newest_loads = state_loads  # the next vectors are K^-1 times these: at first B u_i, then B times the newest vectors
        # v_k, K v_k and B v_k of the basis by columns; there are none yet
        self.vectors = self._images = self._body_loads = np.zeros((len(state_loads), 0))

    def grow(self) -> bool:
        """Extend the basis by K^-1 B times its newest vectors; return whether any was independent of the basis.

        K times the new vectors is computed again: near incompressibility it differs from the loads that they were solved for.
        """
        new = self._solve(self._newest_loads)
        # scaled to unit energy new^T K new; 1e-300 guards against zero loads
        new = new / np.sqrt(np.maximum(np.abs(np.einsum("ik,ik->k", new, self._newest_loads)), 1e-300))
        for _ in range(2):  # twice: one pass leaves rounding errors
            new = new - self.vectors @ (self._images.T @ new)
        images = self._matrix @ new
        gram = new.T @ images
        values, vectors = np.linalg.eigh((gram + gram.T) / 2)
        independent = values > self._negligible
        if not independent.any():
            return False
        turn = vectors[:, independent] / np.sqrt(values[independent])  # makes the new vectors orthonormal in K
        self._newest_loads = self._multiply_body(new @ turn)
        self.vectors, self._images = np.hstack([self.vectors, new @ turn]), np.hstack([self._images, images @ turn])
        self._body_loads = np.hstack([self._body_loads, self._newest_loads])
        return True

    def build_response(self, start: Floats, inside: Floats, weight: float = 1.0) -> RationalResponse:
        """Return the products F(t) of the solutions on the present basis; for the parameters see ``RationalResponse``."""
        energy, coupling = (self.vectors.T @ loads for loads in (self._body_loads, self._state_loads))
        return RationalResponse.from_energies((energy + energy.T) / 2, coupling, start=start, inside=inside, weight=weight)


@dataclass(frozen=True)
class RationalResponse:
    """Products F_ij(t) = u_i(t)^T K(t) u_j(t) for every t > 0, of k solutions with imposed displacements, not loads.

    The products may be those of all k solutions with the first j of them alone.
    With B w_k = l_k K w_k on the turned basis w, c_ki = w_k^T B u_i and G_ij = u_i^T B u_j, u at t = 1,

        F(t) = F(1) + (t - 1) G - (t - 1)^2 sum_k c_k c_k^T / (1 + (t - 1) l_k).

    Attributes
    ----------
    start
        F(1), shape (k, j).
    inside
        G, shape (k, j).
    energy_fractions
        l_k, the part of w_k's energy that is B's, 0 to 1, shape (m,).
    coupling
        c, shape (m, k).
    turn
        Coefficients of w on the basis v, by columns, shape (m, m).
    weight
        Factor of the sum, from the modelled part to the whole body: 2 for one half of a symmetric body.
    """

    start: Floats
    inside: Floats
    energy_fractions: Floats
    coupling: Floats
    turn: Floats
    weight: float = 1.0

    @classmethod
    def from_energies(
        cls, energy: Floats, coupling: Floats, *, start: Floats, inside: Floats, weight: float = 1.0
    ) -> RationalResponse:
        """Build the response from products on any basis v that is orthonormal in K, by making B diagonal.

        Parameters
        ----------
        energy
            v_i^T B v_j, shape (m, m).
        coupling
            v_k^T B u_i, shape (m, k).
        start, inside, weight
            See the class.
        """
        fractions, turn = np.linalg.eigh(energy)
        return cls(start, inside, np.clip(fractions, 0.0, 1.0), turn.T @ coupling, turn=turn, weight=weight)

    def evaluate(self, t: Floats) -> tuple[Floats, Floats]:
        """Return F(t) and dF / d ln t at n numbers t, shape (n,): two arrays of shape (n, k, j)."""
        x = np.asarray(t, dtype=float)[:, None, None] - 1
        denominator = 1 + x[..., 0] * self.energy_fractions
        products = self.weight * self.coupling[:, :, None] * self.coupling[:, None, : self.start.shape[1]]
        total = np.einsum("nk,kij->nij", 1 / denominator, products)
        # d/dx of x^2 / (1 + x l) is x (2 + x l) / (1 + x l)^2; the last line multiplies by t = x + 1, for ln t
        derivative = np.einsum("nk,kij->nij", (2 + x[..., 0] * self.energy_fractions) / denominator**2, products)
        return self.start + x * self.inside - x**2 * total, (x + 1) * (self.inside - x * derivative)

    def compute_amplitudes(self, t: Floats) -> tuple[Floats, Floats]:
        """Return the coefficients of u(t) - u(1) on the basis w, and their derivatives with respect to ln t, (n, m, k) each."""
        x = np.asarray(t, dtype=float)[:, None, None] - 1
        denominator = 1 + x * self.energy_fractions[:, None]
        return -x * self.coupling / denominator, -(x + 1) * self.coupling / denominator**2
