"""Products B^T A^-1 B by PARDISO: those of dense matrices, whatever was computed before, or none."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from solver.linalg import cholesky, schur_complements
from solver.linalg.schur_complements import SchurComplements


def pair(seed: int, unknowns: int = 60, columns: int = 9) -> tuple[sp.csc_array, sp.csr_array]:
    """A positive definite band and a few sparse columns, of one structure for all seeds of one size."""
    rng = np.random.default_rng(seed)
    bands = [rng.uniform(0.1, 1, unknowns - abs(k)) for k in (0, 1, 7)]
    upper = sp.diags_array(bands, offsets=(0, 1, 7))
    A = sp.csc_array(upper + upper.T + 9 * sp.eye_array(unknowns))
    A.sort_indices()
    rows = np.arange(2 * columns) * 3 % unknowns
    return A, sp.csr_array((rng.normal(size=2 * columns), (rows, np.arange(2 * columns) % columns)), shape=(unknowns, columns))


def exact(A: sp.csc_array, B: sp.csr_array) -> np.ndarray:
    return B.toarray().T @ np.linalg.solve(A.toarray(), B.toarray())


@pytest.fixture(autouse=True)
def pardiso() -> None:
    pytest.importorskip("pymklpardiso", reason="py-mkl-pardiso is not installed: it has no wheel for this machine")


def test_products_of_matrices_one_after_the_other() -> None:
    complements = SchurComplements()
    pairs = [pair(0), pair(1), pair(2, unknowns=80, columns=12), pair(0)]
    products = [complements.compute_product(*operands) for operands in pairs]
    for product, operands in zip(products, pairs, strict=True):
        assert product is not None
        np.testing.assert_allclose(product, exact(*operands), rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(products[0], products[3])
    np.testing.assert_array_equal(
        products[1], SchurComplements().compute_product(*pairs[1])
    )  # whatever was asked before, to the last bit


def test_matrices_of_one_structure_are_analysed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    analysed = schur_complements._analyse
    monkeypatch.setattr(schur_complements, "_analyse", lambda *given: seen.append(1) or analysed(*given))
    complements = SchurComplements()
    for seed in range(4):
        complements.compute_product(*pair(seed))
    assert len(seen) == 1


def test_what_is_not_positive_definite_has_none() -> None:
    A, B = pair(0)
    assert SchurComplements().compute_product(sp.csc_array(A - 10 * sp.eye_array(A.shape[0])), B) is None


def test_a_product_that_is_off_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    find_product = SchurComplements._eliminate
    monkeypatch.setattr(SchurComplements, "_eliminate", lambda *given: find_product(*given) * (1 + 1e-6))
    assert SchurComplements().compute_product(*pair(0)) is None


def test_without_pardiso_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cholesky, "load_pardiso", lambda: None)
    assert SchurComplements().compute_product(*pair(0)) is None
