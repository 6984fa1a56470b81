"""Which meshes are made: when two are enough, and whether the third is a rougher or a finer one."""

import numpy as np
import pytest

from geometry import read_scene
from geometry.tetra.sizing import COARSE, FINE, ROUGH, ROUGHEST
from solver.results.film_forces import Bound, FilmForces
from solver.solid import film_forces
from solver.solid.difference import SceneDifference
from solver.solid.film_forces import _agreed, _may_improve
from solver.solid.symmetric_part import symmetric_part
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


@pytest.mark.parametrize(
    ("off", "made"),
    [
        ({ROUGH: 0.003, COARSE: 0.0}, [ROUGH, COARSE]),  # within half the accuracy
        ({ROUGHEST: 0.017, ROUGH: 0.008, COARSE: 0.0}, [ROUGH, COARSE, ROUGHEST]),  # the last step alone would do, and does
        ({ROUGHEST: 0.009, ROUGH: 0.008, COARSE: 0.0, FINE: 0.0}, [ROUGH, COARSE, ROUGHEST, FINE]),  # it would, but steps grow
        ({ROUGH: 0.012, COARSE: 0.0, FINE: 0.0}, [ROUGH, COARSE, FINE]),  # it would not
    ],
)
def test_a_rougher_mesh_is_made_where_its_word_may_do_and_else_a_finer_one(off, made, monkeypatch):
    """Meshes whose film forces are off by known shares, at 1 %; DESIGN asks no price that the answer does not need."""
    scene = read_scene(SCENE)
    symmetric, asked = symmetric_part(scene, 0.01), []
    monkeypatch.setattr(film_forces, "_meshes", lambda domain, stage, tell: [_Mesh(one) for one in stage])

    def difference(domain, mesh, moduli):
        asked.append(mesh.fineness)
        zero = np.zeros((1, 2))
        forces = off[mesh.fineness] * symmetric.exact[None]
        return SceneDifference(forces, np.zeros((1, 2, 2)), zero, zero, symmetric.exact, None, 1, 0.0, 0.0), None

    monkeypatch.setattr(film_forces, "difference", difference)
    _agreed(scene, symmetric, 0.01, None, lambda text: None)
    assert asked == made


class _Mesh:
    def __init__(self, fineness):
        self.fineness, self.elements = fineness, ()
