"""Compute products B^T A^-1 B of sparse matrices by PARDISO in the time of one factorisation, without solves by column.

Eliminating the unknowns of A from ((A, B), (B^T, 0)) leaves -B^T A^-1 B, the Schur complement.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from threading import Lock
from typing import Any

import numpy as np
import scipy.sparse as sp

from geometry.common.arrays import Floats, Ints
from solver.linalg.cholesky import METIS_ORDERING, create_solver, has_pardiso, measure_held_bytes

SCHUR_COMPLEMENT_OPTION, FACTORISATION_PHASE = {35: 1}, 22  # PARDISO's: return the Schur complement of the marked unknowns; phase
MAX_CHECK_ERROR_RELATIVE = 1e-9  # relative, in energy, of the check column; rounding leaves about 1e-15


@dataclass
class _Analysis:
    """PARDISO's analysis of matrices of one ``structure``, and the order of their entries in the upper triangle by rows."""

    solver: Any
    structure: tuple[Ints, ...]
    lower: Any
    order: Ints

    @property
    def foreign_bytes(self) -> int:
        """Bytes that the library holds."""
        return measure_held_bytes(self.solver)


@dataclass
class SchurComplements:
    """Computes products for matrices one after the other; matrices of one pattern are analysed once."""

    _analysis: _Analysis | None = None
    _lock: Any = field(default_factory=Lock, repr=False)

    def compute_product(self, A: Any, B: Any) -> Floats | None:
        """Return B^T A^-1 B, shape (k, k); None without PARDISO, or where A is not positive definite or not solved accurately.

        An additional column A e, e a known vector, has the known product B^T e: it checks the solution.

        Parameters
        ----------
        A
            Symmetric positive definite, both triangles in compressed columns, rows sorted, shape (n, n).
        B
            Sparse by rows, shape (n, k).
        """
        if not has_pardiso():
            return None
        e = np.cos(np.arange(1, A.shape[0] + 1))
        strained = A.T @ e  # A is symmetric, and its transpose, which is stored by rows, is faster in the product
        with self._lock:
            try:  # the check column is the last of k + 1
                complement = self._eliminate(A, sp.hstack([B, sp.csr_array(strained[:, None])], format="csr"))
            except RuntimeError:
                return None
        # a column's product with the check column is at most the root of the product of both energies
        scale = np.sqrt(np.maximum(np.diag(complement)[:-1], 0.0) * (e @ strained))
        if not np.all(np.abs(complement[:-1, -1] - B.T @ e) <= MAX_CHECK_ERROR_RELATIVE * scale):
            return None
        return np.asarray(complement[:-1, :-1])

    def _eliminate(self, A: Any, B: Any) -> Floats:
        """Return B^T A^-1 B, shape (k, k), by eliminating the unknowns of A.

        The analysis is used again as long as both matrices keep their structure: the places of their entries.
        """
        structure = (A.indptr, A.indices, B.indptr, B.indices)
        if self._analysis is None or not all(map(np.array_equal, structure, self._analysis.structure)):
            self._analysis = _analyse(A, B, structure)
        analysis, (n, k) = self._analysis, B.shape
        analysis.solver.set_values(np.concatenate([A.data[analysis.lower], B.data, np.zeros(k)])[analysis.order])
        # PARDISO writes the complement into the array of solutions: as many columns as hold k^2 numbers, rounded up
        out = np.zeros((n + k, -(-(k**2) // (n + k))), order="F")
        analysis.solver.run_phase_into(FACTORISATION_PHASE, np.zeros_like(out), out)
        # eliminating A from ((A, B), (B^T, 0)) leaves -B^T A^-1 B
        complement = -out.ravel(order="F")[: k**2].reshape(k, k)
        return np.asarray((complement + complement.T) / 2)


def _analyse(A: Any, B: Any, structure: tuple[Ints, ...]) -> _Analysis:
    """Analyse the upper triangle of ((A, B), (B^T, 0)) with PARDISO, and find the order of its entries by rows.

    The entries are those of A's triangle, of B, and of a diagonal of zeros below, which PARDISO needs. ``structure`` are the
    places of both matrices' entries.
    """
    (n, k), columns = B.shape, np.repeat(np.arange(A.shape[1]), np.diff(A.indptr))
    lower, diagonal = A.indices >= columns, B.shape[0] + np.arange(B.shape[1])
    rows = np.concatenate([columns[lower], np.repeat(np.arange(n), np.diff(B.indptr)), diagonal])
    columns = np.concatenate([A.indices[lower], n + B.indices, diagonal])
    order = np.lexsort((columns, rows))
    starts = np.searchsorted(rows[order], np.arange(n + k + 1))
    solver = create_solver(METIS_ORDERING | SCHUR_COMPLEMENT_OPTION, starts, columns[order])
    solver.set_perm((np.arange(n + k) >= n).astype(np.int64))
    solver.set_values(np.zeros(len(order)))
    solver.analyze()
    return _Analysis(solver, structure, lower, order)
