"""The residual that results report: small where solvers are good, larger where they are not, none for formulas."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from geometry import read_scene
from solver import evaluate
from solver.axisymmetric import condensed_system as system
from solver.closed_form.designs import build_parameters, iterate_solutions
from solver.linalg.cholesky import Factor, factorise
from solver.linalg.conjugate_gradients import Stiffness, compute_residual
from tests.support.paths import SCENE as EXAMPLE

SCENE = read_scene(EXAMPLE)


class Rough:
    """A factor that is in error by 1e-5."""

    def __init__(self, exact: Factor) -> None:
        self.exact, self.chance = exact, np.random.default_rng(0)

    def solve(self, forces: np.ndarray) -> np.ndarray:
        solution = self.exact.solve(forces)
        return solution * (1 + 1e-5 * self.chance.uniform(-1, 1, solution.shape))


@pytest.mark.parametrize("name", ["axisymmetric", "equivalent-inclusion"])
def test_good_solvers_leave_rounding(name: str) -> None:
    size = evaluate(SCENE, name).residual
    assert size is not None
    assert 0 < size < 1e-15  # relative to |K| |u|, a sum of many terms


def test_it_tells_a_rough_solver_from_a_good_one(monkeypatch: pytest.MonkeyPatch) -> None:
    good = evaluate(SCENE, "axisymmetric")
    with monkeypatch.context() as patched:
        patched.setattr(system, "factorise", lambda *given: Rough(factorise(*given)))
        rough = evaluate(SCENE, "axisymmetric")
    assert rough.residual is not None
    assert rough.residual > 1e-13  # after two passes, each of which leaves about 1e-5 of what was left
    assert rough.ratio == pytest.approx(good.ratio, rel=1e-6)
    assert evaluate(SCENE, "axisymmetric").residual == good.residual  # whatever was asked before


def test_of_a_small_system_by_hand() -> None:
    """K = (2 1; 1 3), f = (1, 2) and v = (0, 1) leave (0, -1): 1 over the root of 5."""
    import scipy.sparse as sp

    lower = sp.csc_array(np.array([[2.0, 0.0], [1.0, 3.0]]))
    size = compute_residual(Stiffness(lower), np.array([[1.0], [2.0]]), np.array([[0.0], [1.0]]))
    assert size == pytest.approx(1 / np.sqrt(5), rel=1e-15)


def test_of_the_closed_form() -> None:
    size = evaluate(SCENE, "closed-form").residual
    assert size is not None
    assert 0 < size < 1e-13
    shape, values = build_parameters(SCENE)
    answer = next(iterate_solutions(shape, values[:, None]))
    wrong = replace(answer, tractions=answer.tractions * (1 + 1e-6)).residual
    assert 1e-9 < wrong[0] <= 1e-6  # a millionth more of all tractions leaves a millionth of A, and |C| |t| is no less than A


def test_the_papers_equations_have_none() -> None:
    result: dict[str, Any] = evaluate(SCENE, "published").as_dict()
    assert result["residual"] is None
