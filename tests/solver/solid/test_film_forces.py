"""Which meshes are made: when two are enough, and whether the third is a rougher or a finer one."""

import numpy as np
import pytest

from geometry import read_scene
from geometry.tetra.sizing import COARSE_FINENESS, FINE_FINENESS, ROUGH_FINENESS, ROUGHEST_FINENESS
from solver.results.film_forces import Bound, FilmForces
from solver.solid import film_forces
from solver.solid.difference import SceneDifference
from solver.solid.film_forces import _may_improve, _refine_until_agreed
from solver.solid.symmetric_part import compute_symmetric_part
from tests.support.paths import SCENE


@pytest.mark.parametrize(
    ("derivative", "error", "enough"),
    [
        (1e-7, 9e-6, True),
        (1e-7, 1.5e-5, False),
        (0.02, 9e-4, True),
        (0.02, 1.5e-3, False),
        (0.02, 2.5e-3, True),
        (1e-7, 3e-5, True),
    ],
)
def test_a_third_mesh_is_made_where_it_may_reach_what_is_promised(derivative, error, enough):
    """DESIGN: log_sensitivity is promised within 5 times the accuracy of itself, or within 1e-5 where it is nearly zero.

    Beyond twice that a third mesh would not reach it.
    """
    forces = np.array([[40.0, -1.0], [-1.0, 60.0]])
    films = FilmForces(
        forces, Bound(1e-3 * forces.sum(axis=1), 1e-3), np.diag(derivative * forces.sum(axis=1) * [1.0, 0.0]), error
    )
    assert films.log_sensitivity == pytest.approx(derivative)
    assert _may_improve(films, read_scene(SCENE), 0.01) is not enough


@pytest.mark.parametrize(
    ("error", "made"),
    [
        ({ROUGH_FINENESS: 0.003, COARSE_FINENESS: 0.0}, [ROUGH_FINENESS, COARSE_FINENESS]),  # within half the accuracy
        (
            {ROUGHEST_FINENESS: 0.017, ROUGH_FINENESS: 0.008, COARSE_FINENESS: 0.0},
            [ROUGH_FINENESS, COARSE_FINENESS, ROUGHEST_FINENESS],
        ),  # the last step alone would do, and does
        (
            {ROUGHEST_FINENESS: 0.009, ROUGH_FINENESS: 0.008, COARSE_FINENESS: 0.0, FINE_FINENESS: 0.0},
            [ROUGH_FINENESS, COARSE_FINENESS, ROUGHEST_FINENESS, FINE_FINENESS],
        ),  # it would, but steps grow
        (
            {ROUGH_FINENESS: 0.012, COARSE_FINENESS: 0.0, FINE_FINENESS: 0.0},
            [ROUGH_FINENESS, COARSE_FINENESS, FINE_FINENESS],
        ),  # it would not
    ],
)
def test_a_rougher_mesh_is_made_where_its_word_may_do_and_else_a_finer_one(error, made, monkeypatch):
    """Meshes whose film forces are in error by known shares, at 1 %; DESIGN asks no price that the result does not need."""
    scene = read_scene(SCENE)
    symmetric, requests = compute_symmetric_part(scene, 0.01), []
    monkeypatch.setattr(film_forces, "_iterate_meshes", lambda domain, stage, progress: [_Mesh(made_mesh) for made_mesh in stage])

    def solve_difference(domain, mesh, moduli):
        requests.append(mesh.fineness)
        zero = np.zeros((1, 2))
        forces = error[mesh.fineness] * symmetric.exact[None]
        return SceneDifference(forces, np.zeros((1, 2, 2)), zero, zero, symmetric.exact, None, 1, 0.0, 0.0), None

    monkeypatch.setattr(film_forces, "solve_difference", solve_difference)
    _refine_until_agreed(scene, symmetric, 0.01, None, lambda text: None)
    assert requests == made


class _Mesh:
    def __init__(self, fineness):
        self.fineness, self.elements = fineness, ()
