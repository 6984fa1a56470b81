import numpy as np
import pytest
import scipy.sparse as sp

from geometry.common.errors import SolveError
from geometry.common.resources import LimitReached, Limits, start_clock, use_limits
from solver.linalg import conjugate_gradients as module
from solver.linalg.conjugate_gradients import Stiffness, compute_residual, estimate_held_bytes, get_analysis, solve


@pytest.fixture
def matrix():
    """A grid of springs."""
    line = sp.diags_array([-1.0, 2.1, -1.0], offsets=[-1, 0, 1], shape=(12, 12))
    whole = sp.kronsum(sp.kronsum(line, line), line)
    return Stiffness(sp.csc_array(sp.tril(whole, format="csc")))


class Panic(BaseException):
    """What a panic in Rust becomes in Python."""

    __module__ = "pyo3_runtime"


class Library:
    """rslab, whose factorisation panics, or reports a pivot of zero."""

    def __init__(self, fault):
        self.fault = fault

    def analyze(self, matrix, path):
        raise self.fault


def solves(factor, matrix):
    forces = np.random.default_rng(1).normal(size=(matrix.lower.shape[0], 2))
    return np.abs(matrix @ factor.solve(forces) - forces).max() < 1e-9


def test_where_rslab_panics_another_library_factorises(matrix, monkeypatch):
    monkeypatch.setattr(module, "_load_rslab", lambda: Library(Panic("index out of bounds")))
    assert solves(matrix.factor(), matrix)


def test_an_interruption_is_no_panic(matrix, monkeypatch):
    monkeypatch.setattr(module, "_load_rslab", lambda: Library(KeyboardInterrupt()))
    with pytest.raises(KeyboardInterrupt):
        matrix.factor()


def test_factors_beyond_the_memory_are_refused_before_they_are_made(matrix):
    min_bytes = estimate_held_bytes(matrix.lower.shape[0], 0.0)
    with use_limits(Limits(memory=0.25e9 + min_bytes)), pytest.raises(LimitReached, match=r"memory = .*factors of 1728 unknowns"):
        matrix.factor()
    with use_limits(Limits(memory=0.3e9)):
        assert solves(matrix.factor(), matrix)


def test_the_second_library_is_held_to_the_same_memory(matrix, monkeypatch):
    monkeypatch.setattr(module, "_load_rslab", lambda: None)
    with use_limits(Limits(memory=0.2e9)), pytest.raises(LimitReached):
        matrix.factor()


def test_iterations_end_with_the_time(matrix):
    factor, forces = matrix.factor(), np.ones((matrix.lower.shape[0], 1))
    with use_limits(Limits(seconds=-1.0)), start_clock(), pytest.raises(LimitReached, match="time"):
        solve(matrix, forces, factor)


def test_an_analysis_serves_other_matrices_that_have_its_entries_alone(matrix):
    pytest.importorskip("rslab")
    first = get_analysis(matrix.factor())
    stiffer = Stiffness(matrix.lower * 2.0)
    repeated = stiffer.factor(like=first)
    assert get_analysis(repeated) is first
    assert solves(repeated, stiffer)
    smaller = Stiffness(sp.csc_array(matrix.lower[:-1, :-1]))
    smaller_factor = smaller.factor(like=first)
    assert get_analysis(smaller_factor) is not first
    assert solves(smaller_factor, smaller)


def test_iterations_end_at_the_residual_that_is_asked_for(matrix):
    near_factor, forces = (
        Stiffness(matrix.lower + 0.5 * sp.eye_array(matrix.lower.shape[0], format="csc")).factor(),
        np.ones((1728, 1)),
    )
    coarse, fine = (
        compute_residual(matrix, forces, solve(matrix, forces, near_factor, target=target)) for target in (1e-3, 1e-9)
    )
    assert 1e-9 < coarse <= 1e-3
    assert fine <= 1e-9


def test_a_singular_matrix_is_a_solve_error(matrix):
    matrix.lower.data[:] = 0.0
    with pytest.raises(SolveError, match="could not be factorised"):
        matrix.factor()


@pytest.mark.parametrize(
    ("limited", "left", "enough"), [(True, 3.0e9, False), (True, 5.4e9, True), (True, 1.4e9, True), (False, 3e9, True)]
)
def test_under_a_limit_of_the_system_room_is_left_beside_stacks(monkeypatch, limited, left, enough):
    """Rust's threads take 2 GiB each where they get them: of 3 GB they leave less than a factor of 0.5 GB takes."""
    budget = [left]

    def empty(size, dtype):
        if size > budget[0]:
            raise MemoryError
        budget[0] -= size

    monkeypatch.setattr(module.np, "empty", empty)
    monkeypatch.setattr(module, "_is_memory_limited", lambda: limited)
    monkeypatch.setattr(module.os, "cpu_count", lambda: 1)
    if enough:
        module._check_system_memory(0.5e9)
    else:
        with pytest.raises(LimitReached, match=r"memory = 1 GB wanted: allowed: what the system gives this process"):
            module._check_system_memory(0.5e9)
