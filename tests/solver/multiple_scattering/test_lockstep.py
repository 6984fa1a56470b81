"""Sets of spheres side by side: the results of each alone, from fewer solutions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.readings import compute_readings
from solver.inclusions.tumours import Tumours
from solver.multiple_scattering.lockstep import Steps, run_in_lockstep
from tests.solver.axisymmetric.test_layers import add_layers


@dataclass
class Matrix:
    """Stands in for an order's response."""

    values: Floats
    requests: list[int] = field(default_factory=list)

    def apply(self, data: Floats, often: bool) -> Floats:
        self.requests.append(data.shape[1])
        return np.asarray(self.values @ data)


def walk(orders: list[Any], data: Floats, rounds: int) -> Steps[Floats]:
    """Ask all orders again and again, as reflections do, and end after an own number of rounds."""
    for k in range(rounds):
        for order in orders[: k + 2]:
            data = (yield order, data) / np.linalg.norm(data)
    return data


def test_sets_of_different_length_find_what_they_find_alone_from_fewer_solutions() -> None:
    rng = np.random.default_rng(0)
    orders, data = [Matrix(item) for item in rng.standard_normal((4, 5, 5))], rng.standard_normal((3, 5, 2))
    lengths = (3, 1, 4)
    expected = [run_in_lockstep([walk(orders, item, rounds)])[0] for item, rounds in zip(data, lengths, strict=True)]
    separate_calls = sum(len(item.requests) for item in orders)
    answers = run_in_lockstep([walk(orders, item, rounds) for item, rounds in zip(data, lengths, strict=True)])
    np.testing.assert_allclose(answers, expected, rtol=1e-12)
    assert sum(len(item.requests) for item in orders) - separate_calls < 0.75 * separate_calls
    assert sum(sum(item.requests) for item in orders) == 4 * separate_calls  # as many columns, twice


def test_none_is_none_and_errors_come_through() -> None:
    assert run_in_lockstep([]) == []

    def failing() -> Steps[int]:
        yield Matrix(np.eye(2)), np.ones((2, 1))
        raise SolveError("residual")

    with pytest.raises(SolveError):
        run_in_lockstep([failing(), failing()])


@pytest.mark.slow
def test_tumours_under_a_skin_read_together_read_as_each_alone() -> None:
    base = EquivalentInclusion().prepare(add_layers((1.5, 4e4)), 1e-2)
    x, depth, diameter = (
        np.array([[0.0], [4e-3], [12e-3]]),
        np.array([[7e-3], [8e-3], [11e-3]]),
        np.array([[6e-3], [8e-3], [5e-3]]),
    )
    tumours = Tumours(x, 0.0 * x, depth, diameter, 0.0 * x + 5e4, 0.0 * x + 0.45)
    whole = compute_readings(base, tumours, 0, True, reflect=True)
    for k in range(3):
        single = compute_readings(base, tumours.select(np.array([k])), 0, True, reflect=True)
        np.testing.assert_allclose(whole.forces[k], single.forces[0], rtol=1e-10)
        np.testing.assert_allclose(whole.bound[k], single.bound[0], rtol=1e-6)
        for key, derivatives in single.derivatives.items():
            np.testing.assert_allclose(
                whole.derivatives[key][k], derivatives[0], rtol=1e-8, atol=1e-12 * np.abs(whole.forces).max()
            )
