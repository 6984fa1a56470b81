"""Solves for the stiffness of tetrahedra: a sparse factor of this matrix, or of one near it, and conjugate gradients on top.

rslab (MIT, wheels for Linux, macOS and Windows) factorises as fast as PARDISO on one thread; where it is missing, or panics,
``cholesky.py`` does it. A factor in single precision takes half the memory: conjugate gradients give the digits back, unless
slivers, near incompressibility and contrast come together.
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
from geometry.common.resources import LimitReached, check_memory, check_time, seconds_left
from solver.linalg.cholesky import Factor, factorise, loaded
from solver.linalg.memory import give_back
from solver.linalg.workspace import current

TARGET_RESIDUAL = 1e-9  # relative residual
MOST = 10.0  # times the target: the largest residual that is taken
ROUNDING = 1e-14  # of |K| |v|: what no solver can avoid
MOST_STEPS = 300
BYTES = 120.0  # of a factor in single precision while it is made: times the unknowns to the power of 4/3
KEEP_LITTLE = {"MIMALLOC_PURGE_DELAY": "10", "MIMALLOC_ARENA_EAGER_COMMIT": "0", "MIMALLOC_ARENA_PURGE_MULT": "1"}
ASIDE = 0.5e9  # bytes of its threads, and of pages that its allocator holds: 0.3e9 were too few
STACK = 2**31  # bytes that each of its threads asks the system for
ANALYSED = 2e3  # bytes of an unknown while a matrix is analysed
STUCK = 60  # steps without a residual of half the best
ASSEMBLED = 5e3  # bytes of an unknown: bodies' matrices, a scene's, its reference's
SPEED = 4e10  # operations a second of a factorisation in single precision on two cores; in double it is half
PANIC = "pyo3_runtime"  # the module of what Rust's panics become


class Stiffness:
    """A symmetric matrix of which the lower triangle is kept.

    Attributes:
        lower: compressed columns, rows sorted, shape (n, n).
    """

    def __init__(self, lower: sp.csc_array) -> None:
        self.lower, self._diagonal = lower, lower.diagonal()[:, None]

    def __matmul__(self, v: Floats) -> Floats:
        """K v, shape (n, k)."""
        return np.asarray(self.lower @ v + self.lower.T @ v - self._diagonal * v)

    def magnitude(self, v: Floats) -> Floats:
        """|K| |v|, to which rounding errors are proportional, shape (n, k)."""
        return Stiffness(abs(self.lower)) @ np.abs(v)

    def factor(self, single: bool = False, like: MatrixAnalysis | None = None) -> Factor:
        """Factorise, in double or in single precision; ``like`` as in ``factorised``.

        Raises:
            SolveError: the matrix is singular.
            LimitReached: the factors would take more memory than is allowed, or take too long.
        """
        return factorised(rounded(self.lower) if single else self.lower, like)


def rounded(lower: sp.csc_array) -> sp.csc_array:
    """Return what a factor in single precision is made of; without rslab the matrix itself, as other libraries have none."""
    if _rslab() is None:
        return lower
    return sp.csc_array((lower.data.astype(np.float32), lower.indices, lower.indptr), shape=lower.shape)


@dataclass(frozen=True)
class MatrixAnalysis:
    """Where a matrix has entries, as rslab has analysed it.

    Attributes:
        symbolic: the library's.
        starts, rows: of the columns of the lower triangle.
    """

    symbolic: Any
    starts: NDArray[np.int32]
    rows: NDArray[np.int32]

    @property
    def foreign_bytes(self) -> int:
        """What the library holds."""
        return int(self.symbolic.heap_bytes)

    def fits(self, lower: sp.csc_array) -> bool:
        """Whether a matrix has entries at the same places."""
        return np.array_equal(self.starts, lower.indptr) and np.array_equal(self.rows, lower.indices)


def pattern_of(factor: Factor) -> MatrixAnalysis | None:
    """Return the analysis behind a factor, if it is rslab's."""
    return factor.pattern if isinstance(factor, _Ldlt) else None


def factorised(lower: sp.csc_array, like: MatrixAnalysis | None = None) -> Factor:
    """Factorise a symmetric matrix in the precision of its lower triangle; the analysis ``like`` serves again if it fits.

    Raises:
        SolveError: the matrix is singular.
        LimitReached: the factors would take more memory than is allowed, or take too long.
    """
    library, unknowns = _rslab(), lower.shape[0]
    current().make_room(BYTES * unknowns ** (4 / 3))
    give_back()
    if library is not None:
        try:
            return _Ldlt.of(library, lower, like)
        except BaseException as fault:  # a panic in Rust is no Exception
            if type(fault).__module__ != PANIC:
                raise
    check_memory(f"factors of {unknowns} unknowns", held_bytes(unknowns, _other_bytes(unknowns)))
    full = lower.astype(float)
    return factorise(sp.csc_array(full + sp.tril(full, -1).T), None)


def _other_bytes(unknowns: int) -> float:
    """About what a factor of the other libraries takes, in double precision and, of SuperLU, with both triangles."""
    n = float(unknowns)
    return float(300.0 * n ** (4 / 3) if loaded() else 12 * 8.0 * n**1.5)


class _Ldlt:
    """A factor by rslab, in the matrix's precision."""

    def __init__(self, handle: Any, single: bool, pattern: MatrixAnalysis) -> None:
        self.handle, self.single, self.pattern = handle, single, pattern

    @property
    def foreign_bytes(self) -> int:
        """What the library holds."""
        return int(self.handle.heap_bytes)

    @classmethod
    def of(cls, library: Any, lower: sp.csc_array, like: MatrixAnalysis | None = None) -> _Ldlt:
        n = lower.shape[0]
        pattern = like if like is not None and like.fits(lower) else _analysed(library, lower)
        symbolic = pattern.symbolic
        plan = symbolic.memory_plan(dtype=lower.dtype.name, nrhs=3)["peak_bytes"]
        check_memory(f"factors of {n} unknowns", held_bytes(n, plan))
        single, flops = lower.dtype == np.float32, symbolic.estimate_memory(lower.dtype.name)["factor_flops"]
        check_time(f"factorising {n} unknowns", flops / SPEED * (1 if single else 2))
        _reserve(plan)
        stop = library.Interrupt()
        watch = Timer(min(seconds_left(), TIMEOUT_MAX), stop.cancel)
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
        try:
            return self._solved(forces)
        except BaseException as fault:  # a panic in Rust is no Exception
            if type(fault).__module__ != PANIC:
                raise
            raise SolveError(f"the factor could not be used: {fault}") from None

    def _solved(self, forces: Floats) -> Floats:
        if not self.single:
            return np.asarray(self.handle.solve_many(np.ascontiguousarray(forces)))
        scale = np.maximum(np.abs(forces).max(axis=0), np.finfo(float).tiny)
        return np.asarray(self.handle.solve_many((forces / scale).astype(np.float32)).astype(float) * scale)


def _analysed(library: Any, lower: sp.csc_array) -> MatrixAnalysis:
    _reserve(ANALYSED * lower.shape[0])
    symbolic = library.analyze(lower, path="ldlt")
    give_back()  # what the analysis has freed: without it hundreds of MB more at the peak
    return MatrixAnalysis(symbolic, lower.indptr, lower.indices)


def held_bytes(unknowns: float, factor: float) -> float:
    """Return what is held at most where unknowns are assembled and factorised, the factor's bytes known."""
    return ASSEMBLED * unknowns + factor


def _reserve(size: float) -> None:
    """Ask the system for what a library in Rust takes to hold so many bytes: given too little, it ends the process.

    Raises:
        LimitReached: there is less.
    """
    wanted, stacks = size + ASIDE, []
    if _limited():
        with suppress(MemoryError):  # its threads do with less where they get no such stack, but take it where they can
            for _ in range(2 * (os.cpu_count() or 1)):
                stacks.append(np.empty(STACK, dtype=np.uint8))
    try:
        np.empty(int(wanted), dtype=np.uint8)
    except MemoryError:
        allowed = "what the system gives this process, less; give it more, or ask for a coarser --accuracy or of fewer inclusions"
        raise LimitReached("memory", Words(f"{wanted / 1e9:.2g} GB wanted"), allowed) from None


def _limited() -> bool:
    """Whether the system limits this process's memory, as ``ulimit`` does."""
    try:
        resource = import_module("resource")
    except ImportError:  # Windows
        return False
    return any(resource.getrlimit(kind)[0] != resource.RLIM_INFINITY for kind in (resource.RLIMIT_AS, resource.RLIMIT_DATA))


@cache
def _rslab() -> Any:
    """The library; its allocator, which reads the environment when it is loaded, keeps what is freed for 10 ms only."""
    try:
        with _environment(KEEP_LITTLE):
            return import_module("rslab")
    except ImportError:
        return None


@contextmanager
def _environment(more: Mapping[str, str]) -> Iterator[None]:
    """Add to the environment what the user has not set himself, for a while."""
    own = {key: value for key, value in more.items() if key not in os.environ}
    os.environ.update(own)
    try:
        yield
    finally:
        for key in own:
            del os.environ[key]


def solve(
    matrix: Stiffness, forces: Floats, near: Factor, start: Floats | None = None, target: float = TARGET_RESIDUAL
) -> Floats:
    """Return K^-1 forces, shape (n, k), by conjugate gradients with the factor of a matrix near K; all columns in step.

    They end at the relative residual ``target``; ten times that is the largest that is taken.

    Raises:
        SolveError: what is left of the forces is too large for the solution to be trusted.
        LimitReached: the time is over.
    """
    v = np.zeros_like(forces) if start is None else start.copy()
    remainder, size = forces - matrix @ v, np.maximum(np.linalg.norm(forces, axis=0), np.finfo(float).tiny)
    direction, product = np.zeros_like(remainder), np.zeros(remainder.shape[1])
    was, best, best_v, since = remainder, np.inf, v, 0
    for _ in range(MOST_STEPS):
        check_time("solving")
        now = float(np.max(np.linalg.norm(remainder, axis=0) / size))
        since = 0 if now < best / 2 else since + 1
        if now < best:
            best, best_v = now, v
        if best <= target or since > STUCK:
            break
        z = near.solve(remainder)
        gain = _columns(remainder - was, z)  # Polak and Ribiere: the factor may be no symmetric operator to rounding
        direction, product = z + _ratio(gain, product) * direction, _columns(remainder, z)
        image = matrix @ direction
        step = _ratio(product, _columns(direction, image))
        v, remainder, was = v + step * direction, remainder - step * image, remainder
    _check(matrix, forces, best_v, MOST * target)
    return best_v


def residual(matrix: Stiffness, forces: Floats, v: Floats) -> float:
    """Return what is left of the forces, relative to them, of the worst column; forces and v of shape (n, k)."""
    remainder, size = (np.linalg.norm(x, axis=0) for x in (forces - matrix @ v, forces))
    return float(np.max(remainder / np.maximum(size, np.finfo(float).tiny)))


def _columns(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("ik,ik->k", a, b))


def _ratio(a: Floats, b: Floats) -> Floats:
    return np.divide(a, b, out=np.zeros_like(a), where=b > 0)


def _check(matrix: Stiffness, forces: Floats, v: Floats, largest: float) -> None:
    remainder, size = (np.linalg.norm(x, axis=0) for x in (forces - matrix @ v, forces))
    if np.all(remainder <= largest * size):
        return
    if not np.all(remainder <= np.maximum(largest * size, ROUNDING * np.linalg.norm(matrix.magnitude(v), axis=0))):
        allowed = f"relative residual {residual(matrix, forces, v):.1e}, allowed {largest:.0e}"
        raise SolveError(f"the linear system was not solved: {allowed}")
