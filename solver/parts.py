"""The stiffness of tissue, blocks and inclusion apart, so that stiff bodies do not drown the rest in rounding errors.

A stiff body that moves as a whole has tiny strains on large displacements: computed from them, its
forces lose as many digits as it is stiffer than what holds it. A rigid shift has no energy, so it
is taken out first: the blocks' is prescribed, the inclusion's is read off the solution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from geometry.errors import SolveError
from geometry.grading import Floats

LARGEST_RESIDUAL = 1e-9  # relative, in the 2-norm; direct solves leave about 1e-16


@dataclass(frozen=True)
class Parts:
    """A stiffness matrix as the sum of those of tissue, blocks and inclusion.

    Displacements are ``lift + v``, of two states at once, shape (dofs, 2).

    Attributes:
        tissue, blocks, inclusion: matrices, (dofs, dofs).
        lift: each state's block moved rigidly, all else at rest, shape (dofs, 2); it meets the supports.
        inclusion_z: the dofs that a unit shift of the inclusion along z sets to 1.
    """

    tissue: sp.csc_array
    blocks: sp.csc_array
    inclusion: sp.csc_array
    lift: Floats
    inclusion_z: NDArray[np.int64]

    def solve(self, fixed: NDArray[np.bool_]) -> tuple[Floats, Floats]:
        """Return v, zero where ``fixed``, of the states in equilibrium elsewhere, and the energy that the residual hides.

        The latter, shape (2, 2), is |r_i^T K^-1 r_j|: what the forces change if the equations were met exactly.

        Raises:
            SolveError: the residual is too large for the solution to be trusted.
        """
        free = np.flatnonzero(~fixed)
        whole = self.tissue + self.blocks + self.inclusion
        inner = whole[free][:, free].tocsc()
        factor = splu(inner, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        v = np.zeros_like(self.lift)
        for _ in range(3):  # the passes after the first refine
            v[free] -= factor.solve(self._forces(v)[free])
        left = self._forces(v)[free]
        scale = (abs(whole) @ np.abs(self.lift + v))[free]
        residual = float(np.max(np.linalg.norm(left, axis=0) / np.linalg.norm(scale, axis=0)))
        if not residual <= LARGEST_RESIDUAL:
            allowed = f"relative residual {residual:.1e}, allowed {LARGEST_RESIDUAL:.0e}"
            raise SolveError(f"the linear system was not solved: {allowed}")
        return v, np.abs(left.T @ factor.solve(left))

    def energy(self, v: Floats) -> Floats:
        """Return u_i^T K u_j of the states, shape (2, 2)."""
        return np.asarray(sum(w.T @ (matrix @ w) for matrix, w in self._shifted(v)))

    def rounding(self, v: Floats) -> Floats:
        """Ten standard deviations of ``energy`` when every entry of K carries an independent rounding error, shape (2, 2)."""
        variance = sum((w**2).T @ (matrix.power(2) @ w**2) for matrix, w in self._shifted(v))
        return np.asarray(10 * np.finfo(float).eps * np.sqrt(variance))

    def _forces(self, v: Floats) -> Floats:
        return np.asarray(sum(matrix @ w for matrix, w in self._shifted(v)))

    def strained_inclusion(self, v: Floats) -> Floats:
        """Return the displacements without the inclusion's rigid shift, right for the inclusion's dofs alone."""
        ball = v.copy()
        if self.inclusion_z.size:
            ball[self.inclusion_z] -= v[self.inclusion_z[0]]
        return ball

    def _shifted(self, v: Floats) -> tuple[tuple[sp.csc_array, Floats], ...]:
        """Each part with the displacements that strain it."""
        return (self.tissue, self.lift + v), (self.blocks, v), (self.inclusion, self.strained_inclusion(v))
