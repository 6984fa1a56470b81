"""Triangles of the tissue's far planes, as close to these as tetrahedra beside them want."""

import numpy as np
import pytest

from geometry.tetra import mesher
from geometry.tetra.facets import cut_triangles
from geometry.tetra.layout import build_layout
from geometry.tetra.mesher import ROUGH_FINENESS
from geometry.tetra.surfaces import build_surfaces
from tests.support.scenes import block_scene as scene

COVER = 1e-3  # of the sphere above the floor
FAR = {
    "tissue": {"shape": "cylinder", "radius": "64 mm", "depth": "45 mm", "youngs_modulus": "6 kPa", "poisson_ratio": 0.45},
    "inclusion": [
        {"diameter": "4 mm", "depth": "42 mm", "x": "3 mm", "y": "-26 mm", "target": True, "youngs_modulus": "30 kPa",
         "poisson_ratio": 0.45},
    ],
    "placement": {"x": "56 mm"},
}  # fmt: skip


@pytest.fixture(scope="module")
def far():
    """A small sphere just above the floor, far from the probe; triangles as first drawn, and as given to pytetwild."""
    layout = build_layout(scene(**FAR), False, np.inf, None)
    space, turns, (points, triangles), _ = mesher._prepare_tetwild(layout, ROUGH_FINENESS)
    return layout, space, build_surfaces(layout, turns, space.linear_radius, 12, 6), (space.to_scene(points), triangles)


def above_the_floor(layout, space, points, triangles):
    """How far the middles of the floor's triangles in the mesher's space are above the floor, and from below the sphere, in m."""
    floor = np.isclose(points[triangles][:, :, 2], -layout.depth).all(axis=1)
    middles = space.to_scene(space.to_mesh(points)[triangles[floor]].mean(axis=1))
    return middles[:, 2] + layout.depth, np.hypot(*(middles - layout.inclusions[0].centre)[:, :2].T)


def test_the_floor_below_a_small_sphere_is_where_its_triangles_are(far):
    """It was half the way up to the sphere, and what lay between was meshed with tetrahedra meant for air."""
    layout, space, coarse_points, fine_points = far
    (coarse, _), (fine, fine_floor) = above_the_floor(layout, space, *coarse_points), above_the_floor(layout, space, *fine_points)
    assert coarse.max() > 0.5 * COVER
    assert np.abs(fine[fine_floor < 5e-3]).max() < 0.15 * COVER
    assert len(fine_points[1]) < 1.2 * len(coarse_points[1])


def test_what_is_added_lies_on_the_tissues_surfaces_and_leaves_no_holes(far):
    layout, _, (given, _), (points, triangles) = far
    new = points[len(given) :]
    x, y = layout.centre
    distances = [new[:, 2], new[:, 2] + layout.depth, np.hypot(new[:, 0] - x, new[:, 1] - y) - layout.tissue_radius]
    assert np.abs(distances).min(axis=0).max() < 1e-11
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert np.unique(sides, axis=0, return_counts=True)[1].min() >= 2


def test_triangles_are_cut_through_one_two_and_three_edges():
    square, edges = np.array([(0, 1, 2), (0, 2, 3)]), np.array([(0, 2), (0, 1), (1, 2)])
    points = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    points = np.vstack([points, points[edges].mean(axis=1)])
    halves = cut_triangles(square, edges, 4)
    a, b, c = np.swapaxes(points[halves], 0, 1)
    areas = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    assert len(halves) == 4 + 2
    assert np.all(areas > 0)  # they are turned as they were
    assert areas.sum() == pytest.approx(1)
    assert not (np.isin(halves, [0, 2]).sum(axis=1) == 2).any()
