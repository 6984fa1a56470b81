"""One azimuthal order's answer on the boundary: by its matrix alone, eliminated or found from its factor, or by the factor."""

from __future__ import annotations

import numpy as np
import pytest

from geometry import read_scene
from solver.equivalent_inclusion.probe_on_tissue import undisturbed
from solver.linalg import cholesky
from solver.linalg.workspace import size
from solver.multiple_scattering.exchange import Reflector
from tests.support.paths import REFERENCE


@pytest.mark.parametrize("m", [0, 1, 2])
def test_matrix_and_factor_answer_alike_and_the_matrix_lets_both_go(m: int, monkeypatch: pytest.MonkeyPatch) -> None:
    base = undisturbed(read_scene(REFERENCE / "axisymmetric" / "shallow.toml"), 0.05)
    reflectors = [Reflector(base.field.states, "bonded") for _ in range(2)]
    eliminated, factored = (one.response(m) for one in reflectors)
    data = np.random.default_rng(0).standard_normal((eliminated.boundary.direct.shape[0], 3))
    quick = eliminated.to(data, often=False)
    with monkeypatch.context() as patched:
        patched.setattr(cholesky, "pardiso", lambda: None)
        solved, beside = factored.to(data, often=False), {id(base.field.states.model.system.numbering)}
        beside |= {id(factored.complements)}
        own = size(factored, beside.copy())
        found = factored.to(data, often=True)
        assert size(factored, beside.copy()) < own / 3
        assert factored.to(data, often=False) == pytest.approx(solved, rel=1e-12)
    for one in (found, quick):
        assert one == pytest.approx(solved, rel=1e-7, abs=1e-9 * np.abs(solved).max())
    np.testing.assert_array_equal(eliminated.to(data, often=True), quick)
