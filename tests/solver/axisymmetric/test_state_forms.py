"""Forms of many states by those of few, against each of them as it stands."""

from __future__ import annotations

import numpy as np

from solver.axisymmetric.state_forms import StateForms

SIZE = 12


def curve(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rational functions of t as in eq. AX.9, of both states on a basis, and their derivatives by ln t, (k, SIZE, 2) each."""
    rng = np.random.default_rng(5)
    share, coupling = rng.uniform(0, 1, SIZE)[:, None], rng.standard_normal((SIZE, 2)) * 0.3 ** np.arange(SIZE)[:, None]
    x = times[:, None, None] - 1
    start = rng.standard_normal((SIZE, 2))
    return start - x * coupling / (1 + x * share), -(x + 1) * coupling / (1 + x * share) ** 2


def totals(A: np.ndarray, u: np.ndarray, w: np.ndarray) -> np.ndarray:
    """w_i^T A (u_1 + u_2) of each pair, shape (k, 2)."""
    return np.einsum("kai,ab,kb->ki", w, A, u.sum(axis=2))


def assert_sums_are_the_forms(u: np.ndarray, w: np.ndarray, max_order: int, tolerance: float) -> None:
    rng = np.random.default_rng(6)
    A = rng.standard_normal((3, SIZE, SIZE))
    A = A + A.swapaxes(1, 2)
    forms = StateForms.choose_pairs(u, w, np.ones(SIZE))
    assert forms.states.shape[2] <= max_order
    chosen = forms.states.transpose(2, 0, 1)
    sums = forms.sum_forms(np.array([totals(matrix, chosen, chosen).T for matrix in A]))
    for k, matrix in enumerate(A):
        for got, true in zip(sums, (totals(matrix, u, u), totals(matrix, u, w) + totals(matrix, w, u)), strict=True):
            np.testing.assert_allclose(got[:, k], true, atol=tolerance * np.abs(true).max())


def test_few_states_stand_for_a_curve() -> None:
    assert_sums_are_the_forms(*curve(np.geomspace(0.03, 300, 50)), 16, 1e-5)


def test_moduli_in_any_order_and_place() -> None:
    times = np.concatenate([np.full(30, 1.0), np.random.default_rng(7).uniform(0.03, 300, 40)])
    assert_sums_are_the_forms(*curve(times), 24, 1e-5)


def test_one_modulus_is_exact() -> None:
    assert_sums_are_the_forms(*curve(np.array([1.7])), 3, 1e-13)


def test_states_that_do_not_change_need_themselves_alone() -> None:
    u, w = curve(np.ones(1))
    assert StateForms.choose_pairs(u, 0 * w, np.ones(SIZE)).states.shape[2] == 1
