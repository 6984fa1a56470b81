"""When two meshes are enough."""

import numpy as np
import pytest

from geometry import read_scene
from solver.results.film_forces import Bound, FilmForces
from solver.solid.film_forces import _good
from tests.support.paths import SCENE


@pytest.mark.parametrize(
    ("slope", "error", "enough"), [(1e-7, 9e-6, True), (1e-7, 2e-5, False), (0.02, 9e-4, True), (0.02, 2e-3, False)]
)
def test_a_target_that_hardly_matters_needs_no_third_mesh(slope, error, enough):
    """DESIGN: log_sensitivity is promised within 5 times the accuracy of itself, or within 1e-5 where it is nearly zero."""
    forces = np.array([[40.0, -1.0], [-1.0, 60.0]])
    films = FilmForces(forces, Bound(1e-3 * forces.sum(axis=1), 1e-3), np.diag(slope * forces.sum(axis=1) * [1.0, 0.0]), error)
    assert films.log_sensitivity == pytest.approx(slope)
    assert _good(films, read_scene(SCENE), 0.01) is enough
