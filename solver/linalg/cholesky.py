"""Factorise sparse matrices: by PARDISO where it is installed, else by SciPy's SuperLU.

PARDISO (``pip install '.[fast]'``) analyses a pattern once and then factorises 5 to 10 times faster than
SuperLU (benchmarks/evaluators/factorisations.py). Of matrices of one ``Pattern`` it keeps the factors of the last;
older ones are factorised again when they are used.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from threading import Lock
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from geometry.common.arrays import Floats, Ints

METIS_ORDERING = {1: 2}  # PARDISO's parameter 1: nested dissection
MINIMUM_DEGREE_ORDERING = {1: 0}  # for meridian meshes a tenth fewer operations than METIS, and ordered in half of the time
POSITIVE_DEFINITE_TYPE = 2  # PARDISO's matrix type: real, symmetric positive definite


class Factor(Protocol):
    """A factorised matrix K."""

    def solve(self, forces: Floats) -> Floats:
        """Return K^-1 forces, shape (unknowns, k) both."""
        ...


class Pattern:
    """The sparsity pattern that several matrices share; it holds PARDISO's analysis and the factors of the last matrix."""

    analysis: _PatternAnalysis | None = None


def factorise(matrix: Any, pattern: Pattern | None) -> Factor:
    """Factorise a symmetric positive definite matrix in compressed columns (``scipy.sparse.csc_array``).

    Parameters
    ----------
    matrix
        Both triangles, rows sorted.
    pattern
        The object that all matrices of one mesh share; None for a single matrix.
    """
    if has_pardiso():
        try:
            return _Pardiso.from_matrix(matrix, pattern)
        except RuntimeError:  # not positive definite to rounding: SuperLU pivots
            pass
    return _SuperLU(splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}))


def factorise_any(matrix: Any) -> Factor:
    """Factorise a matrix in compressed columns that need not be symmetric, by SuperLU.

    Its pattern has to be symmetric: an ordering for symmetric patterns fills in less than a general one.
    """
    return _SuperLU(splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.01))


def has_pardiso() -> bool:
    """Return whether PARDISO is installed; its library is loaded as a side effect."""
    return load_pardiso() is not None


@cache
def load_pardiso() -> Any:
    """Return PARDISO's compiled module, or None.

    Its Python interface is not used: it checks every row first, which takes half as long as the factorisation.
    """
    try:
        return import_module("pymklpardiso._mkl_pardiso")
    except ImportError:
        return None


def create_solver(options: dict[int, int], starts: Ints, columns: Ints) -> Any:
    """Return PARDISO's object for symmetric positive definite matrices of one pattern, that of their upper triangle by rows.

    Parameters
    ----------
    options
        PARDISO's parameters, number: value.
    starts, columns
        Where each row's entries begin and where the last ends, shape (n + 1,), and the entries' columns.
    """
    solver = load_pardiso().PardisoSolver(POSITIVE_DEFINITE_TYPE, 0)
    for key, value in options.items():
        solver.set_iparm(key, value)
    solver.set_pattern(ia=starts.astype(np.int64), ja=columns.astype(np.int64), n=len(starts) - 1)
    return solver


def measure_held_bytes(solver: Any) -> int:
    """Return the bytes that PARDISO holds: analysis and factors (given in kB), and the matrix twice, as given and permuted."""
    # iparm 15 and 16: kB that stay after the analysis, and of the factors
    factors = 1024 * int(solver.get_iparm_value(15) + solver.get_iparm_value(16))
    return factors + 2 * 12 * int(solver.nnz())  # 8 bytes for a value, 4 for its column


@dataclass(frozen=True)
class _SuperLU:
    """A factor by SciPy's SuperLU."""

    factors: Any

    @property
    def foreign_bytes(self) -> int:
        """Bytes that the library holds: values and rows of both triangles."""
        return 12 * int(self.factors.nnz)  # 8 bytes for a value, 4 for its row

    def solve(self, forces: Floats) -> Floats:
        """Return K^-1 forces, shape (unknowns, k) both."""
        return np.asarray(self.factors.solve(forces))


@dataclass
class _PatternAnalysis:
    """PARDISO's analysis of a pattern, and the values that it factorised last.

    Attributes
    ----------
    solver
        The library's object, which holds analysis and factors.
    lower
        Mask of the matrix's entries in the lower triangle.
    values
        Entries of the matrix that was factorised last, both triangles.
    lock
        Held while the solver is used.
    """

    solver: Any
    lower: NDArray[np.bool_]
    values: Floats
    lock: Any = field(default_factory=Lock)

    @property
    def foreign_bytes(self) -> int:
        """Bytes that the library holds."""
        return measure_held_bytes(self.solver)


@dataclass(frozen=True)
class _Pardiso:
    """A factor by PARDISO: the values of a matrix, and the analysis that matrices of its pattern share."""

    analysis: _PatternAnalysis
    values: Floats

    @classmethod
    def from_matrix(cls, matrix: Any, pattern: Pattern | None) -> _Pardiso:
        """Factorise a matrix with the pattern's analysis, made if there is none; see ``factorise``."""
        analysis = None if pattern is None else pattern.analysis
        if analysis is None:
            lower, values = matrix.indices >= np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr)), matrix.data
            solver = _factorise_lower(matrix, lower, METIS_ORDERING if pattern is None else MINIMUM_DEGREE_ORDERING)
            if pattern is None:  # no other matrix shares the analysis: its values are not needed again
                lower, values = np.empty(0, dtype=bool), np.empty(0)
            analysis = _PatternAnalysis(solver, lower, values)
            if pattern is not None:
                pattern.analysis = analysis
            return cls(analysis, values)
        factor = cls(analysis, matrix.data)  # an array that the matrix has already
        with analysis.lock:
            factor._refresh()
        return factor

    def solve(self, forces: Floats) -> Floats:
        """Solve for forces, one column or several; factorise anew if the shared analysis holds the factors of another matrix."""
        with self.analysis.lock:
            self._refresh()
            return np.asarray(self.analysis.solver.solve(np.asarray(forces)))

    def _refresh(self) -> None:
        """Factorise again if another matrix of the pattern was factorised since."""
        if self.analysis.values is not self.values:  # the same array, not only equal numbers
            self.analysis.solver.refactor_values(self.values[self.analysis.lower])
            self.analysis.values = self.values


def _factorise_lower(matrix: Any, lower: NDArray[np.bool_], ordering: dict[int, int]) -> Any:
    """Analyse and factorise a matrix by PARDISO; return the library's object.

    PARDISO reads rows: the lower triangle by columns is the upper one by rows.

    Parameters
    ----------
    matrix
        Both triangles in compressed columns, rows sorted.
    lower
        Mask of the matrix's entries in the lower triangle.
    ordering
        PARDISO's parameters (number: value) that choose the order of elimination.
    """
    solver = create_solver(ordering, np.append(0, np.cumsum(lower))[matrix.indptr], matrix.indices[lower])
    solver.factor(matrix.data[lower])
    return solver
