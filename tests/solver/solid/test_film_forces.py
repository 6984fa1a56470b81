"""When two meshes are enough."""

import numpy as np
import pytest

from geometry import read_scene
from solver.results.film_forces import Bound, FilmForces
from solver.solid.film_forces import _may_improve
from tests.support.paths import SCENE


@pytest.mark.parametrize(
    ("slope", "error", "enough"),
    [
        (1e-7, 9e-6, True),
        (1e-7, 1.5e-5, False),
        (0.02, 9e-4, True),
        (0.02, 1.5e-3, False),
        (0.02, 2.5e-3, True),
        (1e-7, 3e-5, True),
    ],
)
def test_a_third_mesh_is_made_where_it_may_reach_what_is_promised(slope, error, enough):
    """DESIGN: log_sensitivity is promised within 5 times the accuracy of itself, or within 1e-5 where it is nearly zero.

    Beyond twice that a third mesh would not reach it.
    """
    forces = np.array([[40.0, -1.0], [-1.0, 60.0]])
    films = FilmForces(forces, Bound(1e-3 * forces.sum(axis=1), 1e-3), np.diag(slope * forces.sum(axis=1) * [1.0, 0.0]), error)
    assert films.log_sensitivity == pytest.approx(slope)
    assert _may_improve(films, read_scene(SCENE), 0.01) is not enough
