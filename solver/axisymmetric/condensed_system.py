"""A condensed linear system: factorised once, solved for any forces, its residual known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from solver.axisymmetric.dofs import Numbering
from solver.linalg.cholesky import Factor, factorise

LARGEST_RESIDUAL = 1e-9  # relative, in the 2-norm; direct solves leave about 1e-16


@dataclass(frozen=True)
class System:
    """The stiffness of all elements, condensed to corners and edges, and its factors.

    A rigid shift strains nothing, but a stiff element computes large forces from its rounding errors.
    So each element is told its displacements less the shift of its first corner.

    Attributes:
        numbering: of the unknowns.
        stiffness: of the elements, shape (n, 8 p, 8 p).
        matrix: they assembled, shape (unknowns, unknowns).
        factor: of it.
    """

    numbering: Numbering
    stiffness: Floats
    matrix: Any
    factor: Factor

    @classmethod
    def of(cls, numbering: Numbering, stiffness: Floats) -> System:
        """Assemble and factorise."""
        matrix = numbering.assemble(stiffness)
        return cls(numbering, stiffness, matrix, factorise(matrix, numbering.pattern))

    def own(self, v: Floats, lift: Floats | float = 0.0) -> Floats:
        """The elements' own values of displacements v (unknowns, k) and lift (n, 8 p, k), rigid shifts taken out; (n, 8 p, k)."""
        local = self._local(v, lift)
        up = self.numbering.vertical
        return np.asarray(local - local[:, None, np.argmax(up)] * up[:, None])

    def shifts(self, v: Floats, lift: Floats | float = 0.0) -> Floats:
        """The rigid shifts along z that ``own`` takes out, shape (n, k)."""
        return self._local(v, lift)[:, np.argmax(self.numbering.vertical)]

    def _local(self, v: Floats, lift: Floats | float) -> Floats:
        return np.asarray((self.numbering.gather @ v).reshape(*self.stiffness.shape[:2], v.shape[1]) + lift)

    def add_up(self, forces: Floats) -> Floats:
        """Add the elements' forces, shape (n, 8 p, k), to those of the unknowns."""
        return np.asarray(self.numbering.spread @ forces.reshape(self.numbering.gather.shape[0], forces.shape[-1]))

    def lifted(self, lift: Floats) -> Floats:
        """Forces of the lift alone, shape (unknowns, k); few elements have any."""
        some = np.flatnonzero(np.any(lift != 0, axis=(1, 2)))
        local, up = lift[some], self.numbering.vertical
        forces = np.zeros((*self.stiffness.shape[:2], lift.shape[-1]))
        forces[some] = self.stiffness[some] @ (local - local[:, None, np.argmax(up)] * up[:, None])
        return self.add_up(forces)

    def solve(self, forces: Floats, lift: Floats | float = 0.0, passes: int = 1) -> tuple[Floats, Floats, float]:
        """Return displacements v with K (v + lift) = forces, what is left of the forces, (unknowns, k) both, and its share.

        Raises:
            SolveError: what is left is too large for the solution to be trusted.
        """
        v = np.zeros_like(forces)
        unbalanced = forces - self.lifted(lift) if isinstance(lift, np.ndarray) else forces
        for _ in range(passes):
            v = v + self.factor.solve(unbalanced)
            unbalanced = forces - self.add_up(self.stiffness @ self.own(v, lift))
        scale = np.linalg.norm(self._magnitude(v, lift) + np.abs(forces), axis=0)
        residual = float(np.max(np.linalg.norm(unbalanced, axis=0) / np.where(scale > 0, scale, 1.0)))
        if not residual <= LARGEST_RESIDUAL:
            allowed = f"relative residual {residual:.1e}, allowed {LARGEST_RESIDUAL:.0e}"
            raise SolveError(f"the linear system was not solved: {allowed}")
        return v, unbalanced, residual

    def _magnitude(self, v: Floats, lift: Floats | float) -> Floats:
        """|K| |u|, to which rounding errors are proportional."""
        local = np.abs((self.numbering.gather @ v).reshape(*self.stiffness.shape[:2], -1)) + np.abs(lift)
        return np.asarray(self.numbering.reach @ (np.abs(self.stiffness) @ local).reshape(-1, v.shape[-1]))
