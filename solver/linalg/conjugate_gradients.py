"""Solve systems with the stiffness of tetrahedra by conjugate gradients, preconditioned by a sparse factor.

The factor is that of the matrix itself or of a similar one.

rslab (MIT, wheels for Linux, macOS and Windows) factorises as fast as PARDISO on one thread; where it is missing, or panics,
``cholesky.py`` is used. A factor in single precision takes half the memory: conjugate gradients restore the digits, unless
slivers, near incompressibility and a high contrast of moduli combine.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from threading import TIMEOUT_MAX, Timer
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError, Words
from geometry.common.resources import LimitReached, check_memory, check_time, find_seconds_left
from solver.linalg.cholesky import Factor, factorise, has_pardiso
from solver.linalg.memory import give_back
from solver.linalg.workspace import get_workspace

TARGET_RESIDUAL = 1e-9  # relative residual
MAX_RESIDUAL_FACTOR = 10.0  # times the target: the largest residual that is accepted
ROUNDING_RELATIVE = 1e-14  # of |K| |v|: the residual that no solver can avoid
MAX_STEPS = 300
FACTOR_BYTES = 120.0  # times unknowns^(4/3): memory of a single-precision factorisation
ALLOCATOR_ENVIRONMENT = {"MIMALLOC_PURGE_DELAY": "10", "MIMALLOC_ARENA_EAGER_COMMIT": "0", "MIMALLOC_ARENA_PURGE_MULT": "1"}
RESERVED_BYTES = 0.5e9  # for rslab's threads and the pages of its allocator: 0.3e9 were too few
STACK_BYTES = 2**31  # that each of rslab's threads requests from the system
ANALYSIS_BYTES_PER_UNKNOWN = 2e3  # while a matrix is analysed
MAX_STALLED_STEPS = 60  # steps in which the best residual was not halved
ASSEMBLY_BYTES_PER_UNKNOWN = 5e3  # matrices of the bodies, the scene and its reference
OPERATIONS_PER_SECOND = 4e10  # of a single-precision factorisation on two cores; half in double precision
PANIC_MODULE = "pyo3_runtime"  # module of the exceptions that panics in Rust raise


class Stiffness:
    """A symmetric matrix stored by its lower triangle.

    Attributes
    ----------
    lower
        Compressed columns, rows sorted, shape (n, n).
    """

    def __init__(self, lower: sp.csc_array) -> None:
        self.lower, self._diagonal = lower, lower.diagonal()[:, None]

    def __matmul__(self, v: Floats) -> Floats:
        """Return the matrix times v, shape (n, k) both, from its lower triangle."""
        return np.asarray(self.lower @ v + self.lower.T @ v - self._diagonal * v)  # the diagonal is in both triangles

    def compute_magnitude(self, v: Floats) -> Floats:
        """Return |K| |v|, K this matrix, entry by entry: rounding errors of K v are proportional to it; shape (n, k)."""
        return Stiffness(abs(self.lower)) @ np.abs(v)

    def factor(self, single: bool = False, like: MatrixAnalysis | None = None) -> Factor:
        """Factorise in double or in single precision; ``like`` as in ``factorise_lower``.

        Raises
        ------
        SolveError
            The matrix is singular.
        LimitReached
            The factors would take more memory than is allowed, or take too long.
        """
        return factorise_lower(round_to_single(self.lower) if single else self.lower, like)


def round_to_single(lower: sp.csc_array) -> sp.csc_array:
    """Return a matrix in single precision; without rslab the matrix itself, as the other libraries need double precision."""
    if _load_rslab() is None:
        return lower
    return sp.csc_array((lower.data.astype(np.float32), lower.indices, lower.indptr), shape=lower.shape)


@dataclass(frozen=True)
class MatrixAnalysis:
    """rslab's analysis of a sparsity pattern.

    Attributes
    ----------
    symbolic
        The library's object.
    starts, rows
        Starts of the columns, and rows of the entries, of the lower triangle in compressed columns.
    """

    symbolic: Any
    starts: NDArray[np.int32]
    rows: NDArray[np.int32]

    @property
    def foreign_bytes(self) -> int:
        """Bytes that the library holds."""
        return int(self.symbolic.heap_bytes)

    def fits(self, lower: sp.csc_array) -> bool:
        """Return whether a matrix has the same pattern."""
        return np.array_equal(self.starts, lower.indptr) and np.array_equal(self.rows, lower.indices)


def get_analysis(factor: Factor) -> MatrixAnalysis | None:
    """Return the analysis behind a factor, if it is rslab's."""
    return factor.pattern if isinstance(factor, _Ldlt) else None


def factorise_lower(lower: sp.csc_array, like: MatrixAnalysis | None = None) -> Factor:
    """Factorise a symmetric matrix in the precision of its lower triangle; the analysis ``like`` is reused if it fits.

    Raises
    ------
    SolveError
        The matrix is singular.
    LimitReached
        The factors would take more memory than is allowed, or take too long.
    """
    library, unknowns = _load_rslab(), lower.shape[0]
    get_workspace().make_room(FACTOR_BYTES * unknowns ** (4 / 3))
    give_back()
    if library is not None:
        try:
            return _Ldlt.from_lower(library, lower, like)
        except BaseException as fault:  # a panic in Rust is not an Exception
            if type(fault).__module__ != PANIC_MODULE:
                raise
    check_memory(f"factors of {unknowns} unknowns", estimate_held_bytes(unknowns, _estimate_other_bytes(unknowns)))
    full = lower.astype(float)
    return factorise(sp.csc_array(full + sp.tril(full, -1).T), None)


def _estimate_other_bytes(unknowns: int) -> float:
    """Estimate the bytes of a factor by PARDISO or SuperLU: double precision, and both triangles for SuperLU."""
    n = float(unknowns)
    # nested dissection leaves of the order of n^(4/3) entries, SuperLU's minimum degree n^1.5, with 12 bytes for each
    return float(300.0 * n ** (4 / 3) if has_pardiso() else 12 * 8.0 * n**1.5)


class _Ldlt:
    """A factor L D L^T by rslab in the precision of the matrix.

    ``handle`` is the library's object, ``single`` whether it is in single precision, ``pattern`` the analysis of its pattern.
    """

    def __init__(self, handle: Any, single: bool, pattern: MatrixAnalysis) -> None:
        self.handle, self.single, self.pattern = handle, single, pattern

    @property
    def foreign_bytes(self) -> int:
        """Bytes that the library holds."""
        return int(self.handle.heap_bytes)

    @classmethod
    def from_lower(cls, library: Any, lower: sp.csc_array, like: MatrixAnalysis | None = None) -> _Ldlt:
        """Factorise a lower triangle, after a check of the memory and time that this takes; see ``factorise_lower``."""
        n = lower.shape[0]
        pattern = like if like is not None and like.fits(lower) else _analyse(library, lower)
        symbolic = pattern.symbolic
        plan = symbolic.memory_plan(dtype=lower.dtype.name, nrhs=3)["peak_bytes"]  # for three loads
        check_memory(f"factors of {n} unknowns", estimate_held_bytes(n, plan))
        single, flops = lower.dtype == np.float32, symbolic.estimate_memory(lower.dtype.name)["factor_flops"]
        check_time(f"factorising {n} unknowns", flops / OPERATIONS_PER_SECOND * (1 if single else 2))
        _check_system_memory(plan)
        stop = library.Interrupt()  # a timer stops the factorisation at the time limit
        watch = Timer(min(find_seconds_left(), TIMEOUT_MAX), stop.cancel)
        watch.daemon = True
        watch.start()
        try:
            return cls(symbolic.factor(lower, interrupt=stop), single, pattern)
        except RuntimeError as error:
            if stop.is_set:
                check_time(f"factorising {n} unknowns")
            raise SolveError(f"the stiffness could not be factorised: {error}") from error
        finally:
            watch.cancel()

    def solve(self, forces: Floats) -> Floats:
        """Return K^-1 forces, shape (unknowns, k) both."""
        try:
            return self._solve(forces)
        except BaseException as fault:  # a panic in Rust is no Exception
            if type(fault).__module__ != PANIC_MODULE:
                raise
            raise SolveError(f"the factor could not be used: {fault}") from None

    def _solve(self, forces: Floats) -> Floats:
        """Solve for forces, (unknowns, k), in the factor's precision; columns are scaled, as the single range is narrow."""
        if not self.single:
            return np.asarray(self.handle.solve_many(np.ascontiguousarray(forces)))
        scale = np.maximum(np.abs(forces).max(axis=0), np.finfo(float).tiny)
        return np.asarray(self.handle.solve_many((forces / scale).astype(np.float32)).astype(float) * scale)


def _analyse(library: Any, lower: sp.csc_array) -> MatrixAnalysis:
    """Analyse the sparsity pattern of a lower triangle."""
    _check_system_memory(ANALYSIS_BYTES_PER_UNKNOWN * lower.shape[0])
    symbolic = library.analyze(lower, path="ldlt")
    give_back()  # memory that the analysis freed: else the peak is hundreds of MB higher
    return MatrixAnalysis(symbolic, lower.indptr, lower.indices)


def estimate_held_bytes(unknowns: float, factor: float) -> float:
    """Estimate the peak memory of assembly and factorisation, bytes, from the unknowns and ``factor``, the factor's bytes."""
    return ASSEMBLY_BYTES_PER_UNKNOWN * unknowns + factor


def _check_system_memory(size: float) -> None:
    """Check that the system provides ``size`` bytes more, as a library in Rust ends the process when it does not.

    Raises
    ------
    LimitReached
        The system provides less.
    """
    wanted, stacks = size + RESERVED_BYTES, []
    if _is_memory_limited():
        with suppress(MemoryError):  # the threads work with less stack, but take this much where they can
            for _ in range(2 * (os.cpu_count() or 1)):
                # held until this function returns, so that the check below counts them
                stacks.append(np.empty(STACK_BYTES, dtype=np.uint8))
    try:
        np.empty(int(wanted), dtype=np.uint8)
    except MemoryError:
        allowed = "what the system gives this process, less; give it more, or ask for a coarser --accuracy or of fewer inclusions"
        raise LimitReached("memory", Words(f"{wanted / 1e9:.2g} GB wanted"), allowed) from None


def _is_memory_limited() -> bool:
    """Return whether the system limits this process's memory, as ``ulimit`` does."""
    try:
        resource = import_module("resource")
    except ImportError:  # Windows
        return False
    return any(resource.getrlimit(kind)[0] != resource.RLIM_INFINITY for kind in (resource.RLIMIT_AS, resource.RLIMIT_DATA))


@cache
def _load_rslab() -> Any:
    """Import rslab, or return None; its allocator is set to return freed memory after 10 ms.

    The allocator reads the environment when the library is loaded.
    """
    try:
        with _set_environment(ALLOCATOR_ENVIRONMENT):
            return import_module("rslab")
    except ImportError:
        return None


@contextmanager
def _set_environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables that the user has not set, within the context."""
    added = {key: value for key, value in variables.items() if key not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for key in added:
            del os.environ[key]


def solve(
    matrix: Stiffness, forces: Floats, factor: Factor, start: Floats | None = None, target: float = TARGET_RESIDUAL
) -> Floats:
    """Solve with a matrix K by preconditioned conjugate gradients, all columns in step; return K^-1 forces, shape (n, k).

    Parameters
    ----------
    matrix
        K, shape (n, n).
    forces
        Right-hand sides, shape (n, k).
    factor
        Factor of a matrix close to K: the preconditioner.
    start
        Solution to start from, shape (n, k); None for zero.
    target
        Relative residual at which the iteration ends; up to ``MAX_RESIDUAL_FACTOR`` times that is accepted.

    Raises
    ------
    SolveError
        The residual is too large for the solution to be trusted.
    LimitReached
        The time limit is exceeded.
    """
    v = np.zeros_like(forces) if start is None else start.copy()
    # remainder: forces out of balance; size: norms of the forces, above 0 so that columns of zeros divide by no zero
    remainder, size = forces - matrix @ v, np.maximum(np.linalg.norm(forces, axis=0), np.finfo(float).tiny)
    direction, product = np.zeros_like(remainder), np.zeros(remainder.shape[1])
    previous, best, best_v, stalled_steps = remainder, np.inf, v, 0
    for _ in range(MAX_STEPS):
        check_time("solving")
        error = float(np.max(np.linalg.norm(remainder, axis=0) / size))
        # rounding may stop the decrease: the best solution is kept, and the iteration ends if no better one follows
        stalled_steps = 0 if error < best / 2 else stalled_steps + 1
        if error < best:
            best, best_v = error, v
        if best <= target or stalled_steps > MAX_STALLED_STEPS:
            break
        z = factor.solve(remainder)
        gain = _multiply_columns(
            remainder - previous, z
        )  # Polak and Ribiere: rounding may make the factor an unsymmetric operator
        direction, product = z + _divide(gain, product) * direction, _multiply_columns(remainder, z)
        image = matrix @ direction
        step = _divide(product, _multiply_columns(direction, image))
        v, remainder, previous = v + step * direction, remainder - step * image, remainder
    _check_residual(matrix, forces, best_v, MAX_RESIDUAL_FACTOR * target)
    return best_v


def compute_residual(matrix: Stiffness, forces: Floats, v: Floats) -> float:
    """Return the largest relative residual of the columns; forces and v of shape (n, k)."""
    remainder, size = (np.linalg.norm(x, axis=0) for x in (forces - matrix @ v, forces))
    return float(np.max(remainder / np.maximum(size, np.finfo(float).tiny)))


def _multiply_columns(a: Floats, b: Floats) -> Floats:
    """Return the scalar products of the columns of a and b, shape (k,)."""
    return np.asarray(np.einsum("ik,ik->k", a, b))


def _divide(a: Floats, b: Floats) -> Floats:
    """Return a / b, and 0 where b is not positive: there a column has converged."""
    return np.divide(a, b, out=np.zeros_like(a), where=b > 0)


def _check_residual(matrix: Stiffness, forces: Floats, v: Floats, max_residual: float) -> None:
    """Raise ``SolveError`` if a column's residual exceeds both ``max_residual``, relative to the forces, and rounding errors."""
    remainder, size = (np.linalg.norm(x, axis=0) for x in (forces - matrix @ v, forces))
    if np.all(remainder <= max_residual * size):
        return
    if not np.all(
        remainder <= np.maximum(max_residual * size, ROUNDING_RELATIVE * np.linalg.norm(matrix.compute_magnitude(v), axis=0))
    ):
        allowed = f"relative residual {compute_residual(matrix, forces, v):.1e}, allowed {max_residual:.0e}"
        raise SolveError(f"the linear system was not solved: {allowed}")
