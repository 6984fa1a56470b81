"""The surfaces that pytetwild is given: closed, of the bodies' volumes, and where far planes are."""

import numpy as np
import pytest
import pyvista

from geometry.tetra.irregular_mesh import _build_soup, _label_cells
from geometry.tetra.layout import build_layout
from geometry.tetra.mesh_check import check_mesh
from geometry.tetra.mesher import TETWILD_MESHER, _try_mesher, estimate_elements
from geometry.tetra.sizing import ROUGH_FINENESS, choose_space
from geometry.tetra.tet_mesh import MeshBody
from tests.support.scenes import block_scene as scene

COVER = 1e-3  # of the sphere above the bottom
FAR = {
    "tissue": {"shape": "cylinder", "radius": "64 mm", "depth": "45 mm", "youngs_modulus": "6 kPa", "poisson_ratio": 0.45},
    "inclusion": [
        {"diameter": "4 mm", "depth": "42 mm", "x": "3 mm", "y": "-26 mm", "target": True, "youngs_modulus": "30 kPa",
         "poisson_ratio": 0.45},
    ],
    "placement": {"x": "56 mm"},
}  # fmt: skip
STIFF = {"youngs_modulus": "60 kPa", "poisson_ratio": 0.45}


def soup_of(layout):
    space = choose_space(layout, ROUGH_FINENESS)
    return space, _build_soup(layout, ROUGH_FINENESS, space, 1.0)


def is_closed(layout, points, triangles):
    """Whether each edge has at least two triangles."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return np.unique(edges, axis=0, return_counts=True)[1].min() >= 2


@pytest.mark.slow
def test_the_floor_below_a_small_sphere_is_where_its_triangles_are():
    """A flat face far away is bent in the mesher's space: with large triangles, it was half the way up to the sphere."""
    layout = build_layout(scene(**FAR), False, np.inf, None)
    space, soup = soup_of(layout)
    points = space.to_scene(soup.points)
    floor = soup.triangles[np.isclose(points[soup.triangles][:, :, 2], -layout.depth).all(axis=1)]
    middles = space.to_scene(soup.points[floor].mean(axis=1))
    near = np.hypot(*(middles - layout.inclusions[0].centre)[:, :2].T) < 5e-3
    assert np.abs(middles[near, 2] + layout.depth).max() < 0.15 * COVER
    assert is_closed(layout, soup.points, soup.triangles)


@pytest.mark.slow
@pytest.mark.parametrize("half", [True, False])
@pytest.mark.parametrize("hole", [4.1e-3, 4.005e-3])
def test_what_lies_in_a_body_is_labelled_by_it(half, hole, tmp_path):
    """Points by formulas, some of them in a hairline gap; a body from a file has its own label."""
    pyvista.Icosphere(radius=2.0, nsub=2).save(tmp_path / "ball.stl")
    egg = {"diameter": "4 mm", "depth": "9 mm", "x": "-4 mm", **STIFF}
    file = {"surface": str(tmp_path / "ball.stl"), "depth": "9 mm", "x": "4 mm", **STIFF}
    layout = build_layout(scene(inclusion=[egg] if half else [file, egg]), half, 0.1, None)
    space, soup = soup_of(layout)
    assert is_closed(layout, soup.points, soup.triangles)
    width, depth = layout.groove
    y, top = 0.1e-3, layout.outer_height - depth / 2
    ring = (layout.hole + layout.tube) / 2
    places = {
        (1e-3, y, 1e-3): MeshBody.INNER,
        (-ring, y, 1e-3): MeshBody.OUTER,
        (ring, y, top): MeshBody.GROOVE,
        (ring, 1.5 * width, top): MeshBody.OUTER,
        (-(layout.inner + layout.hole) / 2, y, 1e-3): MeshBody.AIR,
        (1e-3, y, -1e-3): MeshBody.TISSUE,
        (0.999 * layout.wall + 0.5e-3, y, -1e-3): MeshBody.BEYOND,
        (-4e-3, y, -9e-3): MeshBody.FIRST_INCLUSION + (not half),
        (1e-3, -1e-3, -1e-3): MeshBody.MIRROR if half else MeshBody.TISSUE,
        (1e-3, y, -layout.depth - 1e-3): MeshBody.AIR,
    } | ({} if half else {(4e-3, y, -9e-3): MeshBody.FIRST_INCLUSION})
    body, is_beyond = _label_cells(layout, space, soup.enclosures, space.to_mesh(np.array(list(places))))
    assert body.tolist() == list(places.values())
    assert (is_beyond == (body == MeshBody.BEYOND)).all()


EDGE = {
    "tissue": {"shape": "block", "length": "100 mm", "breadth": "80 mm", "depth": "60 mm", "youngs_modulus": "6 kPa",
               "poisson_ratio": 0.45},
    "inclusion": [
        {"diameter": "8 mm", "depth": "10 mm", "x": "-15 mm", "target": True, "youngs_modulus": "30 kPa", "poisson_ratio": 0.45},
        {"diameter": "5 mm", "depth": "10 mm", "x": "15 mm", "youngs_modulus": "30 kPa", "poisson_ratio": 0.45},
    ],
    "placement": {"x": "35 mm"},
}  # fmt: skip


@pytest.mark.slow
def test_a_probe_near_a_blocks_edge_is_meshed():
    """It was refused after three trials of each mesh: folded or flat elements at the bottom.

    pytetwild's meshes differ from run to run: one to three trials have been seen, each finer than the one before it.
    """
    layout = build_layout(scene(**EDGE), True, np.inf, None)
    mesh, _ = _try_mesher(layout, ROUGH_FINENESS, TETWILD_MESHER)
    check_mesh(mesh, layout)
    assert 0.8 < len(mesh.elements) / estimate_elements(layout, ROUGH_FINENESS) < 3.5
