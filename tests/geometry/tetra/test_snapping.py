"""Edges of elements that follow curved surfaces."""

import numpy as np
import pytest

from geometry.tetra.body_layout import Ellipsoid
from geometry.tetra.snapping import Surface, curve_mesh
from geometry.tetra.tet_mesh import EDGE_CORNERS, compute_scaled_jacobians

KEEP = 0.2


@pytest.fixture
def flat():
    """A flat element with all corners and two faces on a sphere, as pytetwild leaves them, and its curved nodes."""
    angles = np.array([(0.28, 0.0), (-0.28, 0.0), (0.0, 0.3), (0.0, -0.3)])  # from a pole, along x and along y
    corners = np.column_stack([np.sin(angles), np.sqrt(1 - (np.sin(angles) ** 2).sum(axis=1))])
    cells = np.array([(0, 1, 2, 3)])
    if np.linalg.det(corners[1:] - corners[:1]) < 0:
        cells = cells[:, [0, 1, 3, 2]]
    sphere = Surface(Ellipsoid(np.zeros(3), np.eye(3)).find_level, lambda a, b: np.zeros(len(a), dtype=bool))
    faces = np.array([(0, 1, 2), (0, 1, 3)])
    nodes, elements = curve_mesh(corners, cells, [sphere], faces=faces, chosen=np.zeros(2, dtype=np.int64), keep=KEEP)
    straight = nodes.copy()
    straight[elements[0, 4:]] = corners[cells[0][EDGE_CORNERS]].mean(axis=1)
    return nodes, elements, straight


def test_the_edge_between_two_faces_of_an_element_on_one_sphere_stays_on_it(flat):
    """All its edges were straightened alike: half of a sphere's, which then lost a hundredth of its volume."""
    nodes, elements, straight = flat
    pairs = np.sort(elements[0, :4][EDGE_CORNERS], axis=1).tolist()
    common = elements[0, 4 + pairs.index([0, 1])]
    assert np.linalg.norm(nodes[common]) == pytest.approx(1)
    edge_nodes = [elements[0, 4 + index] for index, pair in enumerate(pairs) if set(pair) not in ({0, 1}, {2, 3})]
    deviation = 1 - np.linalg.norm(nodes[edge_nodes], axis=1)
    assert deviation.min() > 0
    assert deviation.max() < 1 - np.linalg.norm(straight[edge_nodes], axis=1).max()


def test_what_is_curved_keeps_a_share_of_its_quality(flat):
    nodes, elements, straight = flat
    assert compute_scaled_jacobians(nodes, elements)[0] >= KEEP * compute_scaled_jacobians(straight, elements)[0] > 0
