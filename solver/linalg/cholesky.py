"""Sparse Cholesky factors: by PARDISO where it is installed, else by scipy's SuperLU.

PARDISO (``pip install 'probe-design[fast]'``) analyses a pattern once and then factorises 5 to 10 times faster than
SuperLU (benchmarks/levels/factorisations.py). Of matrices of one ``Pattern`` it keeps the factors of the last;
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

from geometry.common.arrays import Floats

METIS = {1: 2}  # PARDISO's parameter 1: nested dissection
LEAST_DEGREE = {1: 0}  # for meridian meshes a tenth fewer operations than METIS, and ordered in half of the time
POSITIVE_DEFINITE = 2  # PARDISO's matrix type: real, symmetric positive definite


class Factor(Protocol):
    """A factorised matrix K."""

    def solve(self, forces: Floats) -> Floats:
        """Return K^-1 forces, shape (unknowns, k) both."""
        ...


class Pattern:
    """The sparsity pattern that several matrices share; it holds PARDISO's analysis and the factors of the last matrix."""

    analysed: _Analysed | None = None


def factorise(matrix: Any, pattern: Pattern | None) -> Factor:
    """Factorise a symmetric positive definite matrix in compressed columns.

    Args:
        matrix: both triangles, rows sorted.
        pattern: the object that all matrices of one mesh share; None for a single matrix.
    """
    library = pardiso()
    if library is not None:
        try:
            return _Pardiso.of(library, matrix, pattern)
        except RuntimeError:  # not positive definite to rounding: SuperLU pivots
            pass
    return _SuperLU(splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}))


def factorise_any(matrix: Any) -> Factor:
    """Factorise a matrix in compressed columns that need not be symmetric, by SuperLU.

    Its pattern has to be symmetric: an ordering for symmetric patterns fills in less than a general one.
    """
    return _SuperLU(splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.01))


def loaded() -> bool:
    """Return whether PARDISO is installed; its library is loaded as a side effect."""
    return pardiso() is not None


@cache
def pardiso() -> Any:
    """Return PARDISO's compiled module, or None.

    Its Python interface is not used: it checks every row first, which takes half as long as the factorisation.
    """
    try:
        return import_module("pymklpardiso._mkl_pardiso")
    except ImportError:
        return None


@dataclass(frozen=True)
class _SuperLU:
    factors: Any

    @property
    def foreign_bytes(self) -> int:
        """Bytes that the library holds: values and rows of both triangles."""
        return 12 * int(self.factors.nnz)

    def solve(self, forces: Floats) -> Floats:
        return np.asarray(self.factors.solve(forces))


@dataclass
class _Analysed:
    """PARDISO's analysis of a pattern, and the values that it factorised last."""

    solver: Any
    lower: NDArray[np.bool_]
    values: Floats
    lock: Any = field(default_factory=Lock)

    @property
    def foreign_bytes(self) -> int:
        """Bytes that the library holds: analysis and factors (given in kB), and the matrix twice, as given and permuted."""
        factors = 1024 * int(self.solver.get_iparm_value(15) + self.solver.get_iparm_value(16))
        return factors + 2 * 12 * int(self.solver.nnz())


@dataclass(frozen=True)
class _Pardiso:
    analysed: _Analysed
    values: Floats

    @classmethod
    def of(cls, library: Any, matrix: Any, pattern: Pattern | None) -> _Pardiso:
        analysed = None if pattern is None else pattern.analysed
        if analysed is None:
            lower = matrix.indices >= np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
            values = matrix.data[lower]
            solver = _analysis(library, matrix, (lower, values), METIS if pattern is None else LEAST_DEGREE)
            if pattern is None:  # no other matrix shares the analysis: its values are not needed again
                lower, values = np.empty(0, dtype=bool), np.empty(0)
            analysed = _Analysed(solver, lower, values)
            if pattern is not None:
                pattern.analysed = analysed
            return cls(analysed, values)
        factor = cls(analysed, matrix.data[analysed.lower])
        with analysed.lock:
            factor._refresh()
        return factor

    def solve(self, forces: Floats) -> Floats:
        with self.analysed.lock:
            self._refresh()
            return np.asarray(self.analysed.solver.solve(np.asarray(forces)))

    def _refresh(self) -> None:
        if self.analysed.values is not self.values:
            self.analysed.solver.refactor_values(self.values)
            self.analysed.values = self.values


def _analysis(library: Any, matrix: Any, triangle: tuple[NDArray[np.bool_], Floats], ordering: dict[int, int]) -> Any:
    """Analyse and factorise a matrix from its lower triangle: a mask of entries and their values.

    PARDISO reads rows: the lower triangle by columns is the upper one by rows.
    """
    lower, values = triangle
    solver = library.PardisoSolver(POSITIVE_DEFINITE, 0)
    for key, value in ordering.items():
        solver.set_iparm(key, value)
    starts = np.append(0, np.cumsum(lower))[matrix.indptr]
    solver.set_pattern(ia=starts.astype(np.int64), ja=matrix.indices[lower].astype(np.int64), n=matrix.shape[0])
    solver.factor(values)
    return solver
