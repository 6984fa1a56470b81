"""Winding numbers against what they are: the solid angle of a ball's cap, whole numbers of closed surfaces, sums of triangles."""

import numpy as np
import pytest
import pyvista

from geometry.common.winding import WindingTree, compute_solid_angles


def corners(mesh):
    return np.asarray(mesh.points, dtype=float)[mesh.regular_faces]


@pytest.fixture(scope="module")
def ball():
    return corners(pyvista.Icosphere(radius=3.0, nsub=4))  # 5120 triangles


DRAWS = np.random.default_rng(0).uniform(-3.3, 3.3, (1000, 3))


def test_a_closed_surface_goes_round_what_is_inside_once(ball):
    radius = np.linalg.norm(DRAWS, axis=1)
    clear = np.abs(radius - 3) > 0.02  # of its faces
    winding = WindingTree.from_triangles(ball).compute_winding(DRAWS[clear])
    assert np.abs(winding - (radius[clear] < 3)).max() < 0.02


def test_an_open_one_fills_its_solid_angle(ball):
    """Seen from the centre a cap of half angle a has 2 pi (1 - cos a)."""
    cap = ball[ball.mean(axis=1)[:, 2] > 1.5]
    assert WindingTree.from_triangles(cap).compute_winding(np.zeros((1, 3))) == pytest.approx((1 - 0.5) / 2, abs=0.01)


@pytest.mark.parametrize("count", [1, 3, 33, 700])
def test_it_is_the_sum_over_triangles(ball, count):
    chosen = np.random.default_rng(1).permutation(ball)[:count]
    exact = [compute_solid_angles(chosen - point).sum() / (4 * np.pi) for point in DRAWS[:100]]
    assert WindingTree.from_triangles(chosen).compute_winding(DRAWS[:100]) == pytest.approx(exact, abs=0.01)


def test_the_solid_angle_of_an_octant():
    assert compute_solid_angles(np.eye(3)[None]) == pytest.approx([np.pi / 2])


def test_many_triangles_about_many_points_are_not_asked_for_one_by_one(ball):
    tree, requests = WindingTree.from_triangles(ball), []

    class Counted(WindingTree):
        def _add_exactly(self, result, points, point, leaf):
            requests.append(np.diff(self.starts)[leaf].sum())
            super()._add_exactly(result, points, point, leaf)

    Counted(**vars(tree)).compute_winding(DRAWS)
    assert sum(requests) < 0.1 * len(DRAWS) * len(ball)
