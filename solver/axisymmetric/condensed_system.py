"""Solve a condensed linear system: factorised once, solved for any forces, with its residual."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from solver.axisymmetric.dofs import Numbering
from solver.linalg.cholesky import Factor, factorise

MAX_RESIDUAL_RELATIVE = 1e-9  # relative, in the 2-norm; direct solves leave about 1e-16
MAX_LOOSE_RESIDUAL = 1e-12  # relative to the diagonal's part of |K| |u|: below it no closer value is computed


@dataclass(frozen=True)
class System:
    """The stiffness of all elements, condensed to corners and edges, and its factors.

    A rigid shift causes no strain, but a stiff element computes large forces from its rounding errors.
    So each element's displacements are taken relative to those of its first corner.

    Attributes
    ----------
    numbering
        The numbering of the unknowns.
    stiffness
        Of the elements, shape (n, 8 p, 8 p).
    matrix
        The assembled stiffness, shape (unknowns, unknowns).
    factor
        The matrix's Cholesky factor.
    """

    numbering: Numbering
    stiffness: Floats
    matrix: Any
    factor: Factor

    @classmethod
    def from_stiffness(cls, numbering: Numbering, stiffness: Floats) -> System:
        """Assemble and factorise the elements' stiffness, shape (n, 8 p, 8 p)."""
        matrix = numbering.assemble(stiffness)
        return cls(numbering, stiffness, matrix, factorise(matrix, numbering.pattern))

    def compute_values(self, v: Floats, lift: Floats | float = 0.0) -> Floats:
        """Return the elements' values of displacements v (unknowns, k) and lift, both without rigid shifts; (n, 8 p, k)."""
        return self.remove_shift(self._gather_values(v, lift))[0]

    def remove_shift(self, local: Floats) -> tuple[Floats, Floats]:
        """Return elements' values (e, 8 p, k) without their rigid shifts along z, and these shifts, (e, k).

        An element's shift is u_z at its first corner.
        """
        unit_shift = self.numbering.vertical
        shift = local[:, np.argmax(unit_shift)]
        return local - shift[:, None] * unit_shift[:, None], shift

    def _gather_values(self, v: Floats, lift: Floats | float) -> Floats:
        """Return the elements' values of displacements v (unknowns, k) and lift, rigid shifts included; shape (n, 8 p, k)."""
        return np.asarray((self.numbering.gather @ v).reshape(*self.stiffness.shape[:2], v.shape[1]) + lift)

    def assemble_forces(self, forces: Floats) -> Floats:
        """Return the forces on the unknowns, shape (unknowns, k): sums of the elements' forces, shape (n, 8 p, k)."""
        return np.asarray(self.numbering.scatter @ forces.reshape(self.numbering.gather.shape[0], forces.shape[-1]))

    def compute_lift_forces(self, lift: Floats) -> Floats:
        """Return the forces of the lift alone, shape (unknowns, k)."""
        # few elements have a lift: only those are multiplied
        elements = np.flatnonzero(np.any(lift != 0, axis=(1, 2)))
        forces = np.zeros((*self.stiffness.shape[:2], lift.shape[-1]))
        forces[elements] = self.stiffness[elements] @ self.remove_shift(lift[elements])[0]
        return self.assemble_forces(forces)

    def solve(
        self,
        forces: Floats,
        lift: Floats | float = 0.0,
        passes: int = 1,
        max_residual: float = MAX_RESIDUAL_RELATIVE,
    ) -> Solution:
        """Solve K (v + lift) = forces, with iterative refinement in ``passes`` - 1 further steps.

        Parameters
        ----------
        forces
            On the unknowns, k sets, shape (unknowns, k).
        lift
            Elements' values of given displacements, shape (n, 8 p, k), see ``Numbering.lift``; 0 for none.
        passes
            Number of solutions with the factor: the first, and one for each step of refinement.
        max_residual
            Largest relative residual that is accepted.

        Raises
        ------
        SolveError
            The relative residual is above ``max_residual``, so that the solution cannot be trusted.
        """
        v = np.zeros_like(forces)
        unbalanced = forces - self.compute_lift_forces(lift) if isinstance(lift, np.ndarray) else forces
        for _ in range(passes):
            v = v + self.factor.solve(unbalanced)
            local = self._gather_values(v, lift)
            values, shift = self.remove_shift(local)
            loads = self.stiffness @ values
            unbalanced = forces - self.assemble_forces(loads)
        diagonal = np.diagonal(self.stiffness, axis1=1, axis2=2)[..., None]
        residual = self._compute_relative_residual(unbalanced, diagonal * np.abs(local), forces)
        if not residual <= MAX_LOOSE_RESIDUAL:  # "not <=": also for NaN; the exact |K| |u| takes longer
            residual = self._compute_relative_residual(unbalanced, np.abs(self.stiffness) @ np.abs(local), forces)
        if not residual <= max_residual:
            allowed = f"relative residual {residual:.1e}, allowed {max_residual:.0e}"
            raise SolveError(f"the linear system was not solved: {allowed}")
        return Solution(v, values, shift, loads=loads, unbalanced=unbalanced, residual=residual)

    def _compute_relative_residual(self, unbalanced: Floats, magnitude: Floats, forces: Floats) -> float:
        """Return the largest relative residual of k solutions.

        Parameters
        ----------
        unbalanced
            Residual forces, shape (unknowns, k).
        magnitude
            Of the elements' forces, shape (n, 8 p, k); assembled, and with ``forces`` added, it is the reference.
        forces
            On the unknowns, shape (unknowns, k).
        """
        scale = np.linalg.norm(self.numbering.unsigned_scatter @ magnitude.reshape(-1, forces.shape[-1]) + np.abs(forces), axis=0)
        return float(np.max(np.linalg.norm(unbalanced, axis=0) / np.where(scale > 0, scale, 1.0)))


@dataclass(frozen=True)
class Solution:
    """Displacements under k sets of forces.

    Attributes
    ----------
    v
        The unknowns, shape (unknowns, k).
    values
        The elements' values, without rigid shifts, shape (n, 8 p, k).
    shift
        These shifts along z, shape (n, k).
    loads
        The elements' forces, shape (n, 8 p, k).
    unbalanced
        Residual forces, shape (unknowns, k).
    residual
        The largest relative to |K| |u|, to which rounding errors are proportional; where it is small, relative to the diagonal's
        part of |K| |u|, which gives a somewhat larger number.
    """

    v: Floats
    values: Floats
    shift: Floats
    loads: Floats
    unbalanced: Floats
    residual: float
