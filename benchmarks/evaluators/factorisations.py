"""Time sparse Cholesky factorisations.

    python -m benchmarks.evaluators.factorisations [matrix.npz ...] [--threads 1]

Matrices come from ``scipy.sparse.save_npz`` (symmetric, positive definite, both triangles); without any, a
plane grid of dense blocks stands for a condensed mesh. Candidates that are not installed (py-mkl-pardiso, cvxopt, rslab)
are left out. Columns, medians in ms: what is done once for a pattern (superlu_reused and pardiso also factorise then), factors of
new values on it, solves with 2 and with 100 right-hand sides; the largest backward error |b - A x| / (|A| |x| + |b|).

Duration: minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.sparse.linalg import splu
from threadpoolctl import threadpool_limits

from geometry.common.arrays import Floats

Solve = Callable[[Floats], Floats]
Factorise = Callable[[Floats], Solve]  # from the values of one pattern to what solves for right-hand sides
SYMMETRIC: dict[str, Any] = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}


def superlu(matrix: Any, threads: int) -> Factorise:
    return lambda values: splu(_replace_values(matrix, values), permc_spec="MMD_AT_PLUS_A", **SYMMETRIC).solve


def superlu_reused(matrix: Any, threads: int) -> Factorise:
    """SuperLU with the order of a first factorisation, the matrix permuted by one gather."""
    order = np.argsort(splu(matrix, permc_spec="MMD_AT_PLUS_A", **SYMMETRIC).perm_c)
    places = _replace_values(matrix, np.arange(1.0, matrix.nnz + 1))[order][:, order].tocsc()
    places.sort_indices()
    gather, scatter = places.data.astype(np.int64) - 1, np.argsort(order)

    def factorise(values: Floats) -> Solve:
        factor = splu(_replace_values(places, values[gather]), permc_spec="NATURAL", **SYMMETRIC)
        return lambda b: np.asarray(factor.solve(b[order])[scatter])

    return factorise


def pardiso(matrix: Any, threads: int) -> Factorise:
    """PARDISO of Intel's MKL in py-mkl-pardiso (one thread), with METIS; the upper triangle by rows is the lower by columns."""
    keep = _lower(matrix)
    solver = import_module("pymklpardiso").PardisoSolver(sp.tril(matrix, format="csc").T, mtype=2, iparms={1: 2})

    def factorise(values: Floats) -> Solve:
        solver.refactor(values[keep])
        return lambda b: np.asarray(solver.solve(b))

    return factorise


def cholmod(matrix: Any, threads: int) -> Factorise:
    """CHOLMOD, supernodal, as cvxopt ships it (GPL)."""
    keep, cvxopt, package = _lower(matrix), import_module("cvxopt"), import_module("cvxopt.cholmod")
    dense = cvxopt.matrix
    places = (dense(index[keep].astype(np.int64)) for index in matrix.tocoo().coords)
    held = cvxopt.spmatrix(dense(matrix.data[keep]), *places, matrix.shape)
    factor = package.symbolic(held)

    def solve(b: Floats) -> Floats:
        x = dense(b)
        package.solve(factor, x)
        return np.array(x)

    def factorise(values: Floats) -> Solve:
        held.V = dense(values[keep])
        package.numeric(held, factor)
        return solve

    return factorise


def rslab(matrix: Any, threads: int) -> Factorise:
    """RSLAB: supernodal LDL^T in Rust."""
    package = import_module("rslab")
    keep, analysis = _lower(matrix), package.analyze(sp.csc_matrix(matrix), path="ldlt", threads=threads)
    return lambda values: analysis.factor(values[keep], threads=threads).solve_many


CANDIDATES = (superlu, superlu_reused, pardiso, cholmod, rslab)


def _replace_values(matrix: Any, values: Floats) -> Any:
    return sp.csc_array((values, matrix.indices, matrix.indptr), shape=matrix.shape)


def _lower(matrix: Any) -> NDArray[np.bool_]:
    return np.asarray(matrix.indices >= np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr)))


def plane(side: int, width: int) -> Any:
    """Return a positive definite matrix of dense blocks that couple to the eight around them on a square grid."""
    line = sp.diags_array([1.0, 4.0, 1.0], offsets=[-1, 0, 1], shape=(side, side))
    return sp.csc_array(sp.kron(sp.kron(line, line), np.ones((width, width)) + np.eye(width)))


def time_calls(act: Callable[[], Any], seconds: float = 1.0) -> tuple[float, Any]:
    """Return the median time in ms of 3 to 25 calls, and the last result."""
    times: list[float] = []
    while len(times) < 3 or (len(times) < 25 and sum(times) < seconds):
        start = perf_counter()
        result = act()
        times.append(perf_counter() - start)
    return 1e3 * median(times), result


def rows(matrix: Any, threads: int) -> Iterator[tuple[str, ...]]:
    """Time each candidate that is installed."""
    two_sides, hundred_sides = (np.random.default_rng(1).normal(size=(matrix.shape[0], k)) for k in (2, 100))
    for candidate in CANDIDATES:
        try:
            first, factorise = time_calls(partial(candidate, matrix, threads))
        except ImportError:
            continue
        with threadpool_limits(threads):  # of the libraries loaded by now
            refactorised_ms, solve = time_calls(partial(factorise, matrix.data))
            (two, x), (hundred, _) = (time_calls(partial(solve, b)) for b in (two_sides, hundred_sides))
        error = np.max(abs(two_sides - matrix @ x) / (abs(matrix) @ abs(x) + abs(two_sides)))
        yield candidate.__name__, *(f"{time:.3g}" for time in (first, refactorised_ms, two, hundred)), f"{error:.0e}"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("matrices", nargs="*", type=Path)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    matrices = {path.stem: sp.csc_array(sp.load_npz(path)).sorted_indices() for path in options.matrices} or {
        "plane": plane(20, 8)
    }
    for name, matrix in matrices.items():
        table = Table(
            "candidate", title=f"{name}: {matrix.shape[0]} unknowns, {matrix.nnz} entries, {options.threads} threads, ms"
        )
        for heading in ("once", "factor", "2 sides", "100 sides", "error"):
            table.add_column(heading, justify="right")
        for row in rows(matrix, options.threads):
            table.add_row(*row)
        Console().print(table)


if __name__ == "__main__":
    main()
