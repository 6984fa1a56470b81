"""One azimuthal order's response on the boundary: by its matrix alone, eliminated or found from its factor, or by the factor."""

from __future__ import annotations

import numpy as np
import pytest

from geometry import read_scene
from solver.equivalent_inclusion.probe_on_tissue import solve_undisturbed
from solver.linalg import cholesky
from solver.linalg.workspace import measure_bytes
from solver.multiple_scattering.exchange import Reflector
from tests.support.paths import REFERENCE


@pytest.mark.slow
@pytest.mark.parametrize("m", [0, 1, 2])
def test_matrix_and_factor_answer_alike_and_the_matrix_lets_both_go(m: int, monkeypatch: pytest.MonkeyPatch) -> None:
    base = solve_undisturbed(read_scene(REFERENCE / "axisymmetric" / "shallow.toml"), 0.05)
    reflectors = [Reflector(base.field.states, "bonded") for _ in range(2)]
    eliminated, factored = (compliance.find_response(m) for compliance in reflectors)
    data = np.random.default_rng(0).standard_normal((eliminated.boundary.direct.shape[0], 3))
    quick = eliminated.apply(data, often=False)
    with monkeypatch.context() as patched:
        patched.setattr(cholesky, "load_pardiso", lambda: None)
        solved, excluded = factored.apply(data, often=False), {id(base.field.states.model.system.numbering)}
        excluded |= {id(factored.complements)}
        factored_bytes = measure_bytes(factored, excluded.copy())
        solution = factored.apply(data, often=True)
        assert measure_bytes(factored, excluded.copy()) < factored_bytes / 3
        assert factored.apply(data, often=False) == pytest.approx(solved, rel=1e-12)
    for compliance in (solution, quick):
        assert compliance == pytest.approx(solved, rel=1e-7, abs=1e-9 * np.abs(solved).max())
    np.testing.assert_array_equal(eliminated.apply(data, often=True), quick)
