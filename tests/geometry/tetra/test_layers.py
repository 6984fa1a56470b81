"""Tetrahedra cut by planes: whole, common faces, nothing lost; and sizes that know what that costs."""

import math

import numpy as np
import pytest
import pyvista
from scipy.spatial import Delaunay

from geometry.tetra.layers import find_layers, split_at_height
from geometry.tetra.layout import build_layout
from geometry.tetra.mesh_check import compute_errors
from geometry.tetra.mesher import estimate_elements, mesh_layout
from geometry.tetra.sizing import ROUGH_FINENESS
from geometry.tetra.tet_mesh import FACE_CORNERS, MeshBody, compute_volumes
from tests.support.scenes import block_scene as scene

SKIN = {"thickness": "1.5 mm", "youngs_modulus": "56 kPa", "poisson_ratio": 0.45}
FAT = {"thickness": "8 mm", "youngs_modulus": "2 kPa", "poisson_ratio": 0.49}


def volumes(points, cells):
    corners = points[cells]
    return np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6


def outside(points, cells):
    """The area of the faces that belong to one tetrahedron only."""
    faces, count = np.unique(np.sort(cells[:, FACE_CORNERS].reshape(-1, 3), axis=1), axis=0, return_counts=True)
    assert count.max() == 2
    first, two, three = np.moveaxis(points[faces[count == 1]], 1, 0)
    return np.linalg.norm(np.cross(two - first, three - first), axis=1).sum() / 2


@pytest.fixture
def cloud():
    """Delaunay's tetrahedra of points at random, some of them in the planes that will cut."""
    points = np.random.default_rng(3).uniform(-1, 1, (300, 3))
    points[::7, 2], points[::11, 2] = 0.2, -0.35
    cells = Delaunay(points).simplices.astype(np.int64)
    flip = volumes(points, cells) < 0
    cells[flip] = cells[flip][:, [0, 2, 1, 3]]
    return points, cells[volumes(points, cells) > 1e-12]


def test_planes_cut_tetrahedra_into_parts_that_fit_together(cloud):
    points, cells = cloud
    origin = np.arange(len(cells))
    for height in (0.2, -0.35):
        points, cells, parent = split_at_height(points, cells, height)
        origin = origin[parent]
        sides = np.sign(points[cells, 2] - height)
        assert not ((sides > 0).any(axis=1) & (sides < 0).any(axis=1)).any()
    parts = volumes(points, cells)
    assert parts.min() > 0
    np.testing.assert_allclose(np.bincount(origin, weights=parts), volumes(*cloud), rtol=1e-9)
    assert outside(points, cells) == pytest.approx(outside(*cloud), rel=1e-9)  # faces cut differently would add to it


def test_a_plane_beside_all_tetrahedra_changes_nothing(cloud):
    points, cells, parent = split_at_height(*cloud, 2.0)
    assert points is cloud[0]
    assert cells is cloud[1]
    assert (parent == np.arange(len(cells))).all()


def layered_scene(*layers, **changes):
    ground = {"youngs_modulus": "6 kPa", "poisson_ratio": 0.45, "layer": list(layers)}
    return scene(tissue={"shape": "block", "length": "60 mm", "breadth": "50 mm", "depth": "40 mm"} | ground, **changes)


def test_layers_are_numbered_from_the_surface():
    layout = build_layout(layered_scene(SKIN, FAT), True, 0.1, None)
    assert layout.interfaces == pytest.approx((1.5e-3, 9.5e-3))
    assert find_layers(layout, np.array([-1e-3, -2e-3, -9e-3, -10e-3])).tolist() == [1, 2, 2, 0]


def test_thinner_layers_are_expected_to_take_more_tetrahedra():
    counts = [
        estimate_elements(build_layout(layered_scene(SKIN | {"thickness": thickness}), True, 0.1, None), ROUGH_FINENESS)
        for thickness in ("5 mm", "1 mm", "0.1 mm")
    ]
    assert counts[0] >= estimate_elements(build_layout(scene(), True, 0.1, None), ROUGH_FINENESS)
    assert counts[1] > counts[0]
    assert counts[2] > 20 * counts[1]


@pytest.mark.slow
def test_a_body_from_a_file_across_an_interface_is_whole(tmp_path):
    pyvista.Icosphere(radius=3.0, nsub=2).save(tmp_path / "ball.stl")
    stiff = {"youngs_modulus": "60 kPa", "poisson_ratio": 0.45}
    body = {"surface": str(tmp_path / "ball.stl"), "depth": "9 mm", "x": "2 mm"} | stiff
    layout = build_layout(layered_scene(SKIN, FAT, inclusion=[body]), False, 0.1, None)
    mesh, _ = mesh_layout(layout, ROUGH_FINENESS)
    inside = mesh.body == MeshBody.FIRST_INCLUSION
    parts = compute_volumes(mesh.nodes, mesh.elements)
    assert parts[inside].sum() == pytest.approx(layout.inclusions[0].volume, rel=0.02)
    cap_volume = parts[inside & (mesh.layer == 0)].sum()  # a ball's cap under a plane 0.5 mm below its centre
    assert cap_volume == pytest.approx(math.pi * 2.5e-3**2 * (3e-3 - 2.5e-3 / 3), rel=0.08)


@pytest.mark.slow
def test_layers_across_inclusion_groove_and_wall_have_the_scenes_volumes():
    layout = build_layout(layered_scene(SKIN, FAT), True, math.inf, None)
    mesh, _ = mesh_layout(layout, ROUGH_FINENESS)
    names = {f"tissue.layer[{k}]'s volume" for k in (0, 1)}
    assert names < compute_errors(mesh, layout).keys()
    assert max(abs(compute_errors(mesh, layout)[name]) for name in names) < 3e-3
    crossed = np.unique(mesh.layer[mesh.body == MeshBody.FIRST_INCLUSION])
    assert len(crossed) > 1  # the inclusion's parts know which layers' places they take
    low, high = (mesh.nodes[mesh.elements[(mesh.layer == 2) & (mesh.body >= MeshBody.TISSUE)], 2].min(), -1.5e-3)
    assert low == pytest.approx(-9.5e-3, abs=1e-9)
    assert mesh.nodes[mesh.elements[mesh.layer == 2], 2].max() == pytest.approx(high, abs=1e-9)
    assert 0.6 < len(mesh.elements) / estimate_elements(layout, ROUGH_FINENESS) < 1.8
