"""One azimuthal order's answer on the boundary: by its factor and, for many sets of spheres, by its matrix alone."""

from __future__ import annotations

import numpy as np
import pytest

from geometry import read_scene
from solver.equivalent_inclusion.probe_on_tissue import undisturbed
from solver.linalg.workspace import size
from solver.multiple_scattering.exchange import Reflector
from tests.support.paths import REFERENCE


@pytest.mark.parametrize("m", [0, 2])
def test_the_matrix_answers_as_the_factor_does_and_lets_it_go(m: int) -> None:
    base = undisturbed(read_scene(REFERENCE / "axisymmetric" / "shallow.toml"), 0.05)
    reflector = Reflector(base.field.states, "bonded")
    response = reflector.response(m)
    data = np.random.default_rng(0).standard_normal((response.boundary.direct.shape[0], 3))
    solved, beside = response.to(data, often=False), {id(base.field.states.model.system.numbering)}
    own = size(response, beside)
    found = response.to(data, often=True)
    assert found == pytest.approx(solved, rel=1e-7, abs=1e-9 * np.abs(solved).max())
    assert size(response, {id(base.field.states.model.system.numbering)}) < own / 3
    assert response.to(data, often=False) == pytest.approx(solved, rel=1e-12)
