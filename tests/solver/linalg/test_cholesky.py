"""Factors by PARDISO and by SuperLU: one result, and older factors stay good."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from solver.linalg import cholesky as factor


def matrix(seed: int) -> sp.csc_array:
    """A symmetric positive definite matrix: a plane grid's Laplacian with random weights, one pattern for all seeds."""
    weights = np.random.default_rng(seed).uniform(1, 2, 900)
    line = sp.diags_array([-np.ones(29), 2 * np.ones(30), -np.ones(29)], offsets=[-1, 0, 1])
    grid = sp.kron(line, sp.eye_array(30)) + sp.kron(sp.eye_array(30), line) + sp.diags_array(weights)
    columns = sp.csc_array(grid)
    columns.sort_indices()
    return columns


@pytest.mark.parametrize("library", ["SuperLU", "PARDISO"])
def test_every_factor_solves_its_own_matrix(library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if library == "SuperLU":
        monkeypatch.setattr(factor, "load_pardiso", lambda: None)
    else:
        pytest.importorskip("pymklpardiso", reason="py-mkl-pardiso is not installed: it has no wheel for this machine")
    pattern, forces = factor.Pattern(), np.random.default_rng(0).normal(size=(900, 3))
    matrices = [matrix(seed) for seed in range(3)]
    factors = [factor.factorise(sparse_matrix, pattern) for sparse_matrix in matrices]
    for k in (2, 0, 1, 0):
        assert matrices[k] @ factors[k].solve(forces) == pytest.approx(forces, abs=1e-12)
        assert matrices[k] @ factors[k].solve(forces[:, :1]) == pytest.approx(forces[:, :1], abs=1e-12)


def test_what_is_not_positive_definite_goes_to_superlu() -> None:
    pytest.importorskip("pymklpardiso", reason="py-mkl-pardiso is not installed: it has no wheel for this machine")
    indefinite = matrix(0) - 3 * sp.eye_array(900, format="csc")
    forces = np.ones((900, 1))
    solution = factor.factorise(sp.csc_array(indefinite), factor.Pattern()).solve(forces)
    assert indefinite @ solution == pytest.approx(forces, abs=1e-9)


def test_pardiso_is_used_where_it_is_installed() -> None:
    """Its compiled module is no promise of the wrapper's: were it renamed, everything would take SuperLU without a word."""
    pytest.importorskip("pymklpardiso", reason="py-mkl-pardiso is not installed: it has no wheel for this machine")
    assert factor.has_pardiso()
