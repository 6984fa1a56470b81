"""Regular scenes by netgen: whole, exact, the same again; bodies checked by what points say that lie in them."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from geometry.tetra.layout import build_layout, find_extent
from geometry.tetra.mesh_check import MIN_QUALITY, check_mesh, compute_errors
from geometry.tetra.mesher import estimate_elements, is_regular, mesh_layout
from geometry.tetra.regular_mesh import build_shapes, mesh_regular_layout
from geometry.tetra.sizing import ROUGH_FINENESS
from geometry.tetra.tet_mesh import MeshBody
from tests.support.scenes import block_scene as scene

SOFT = {"youngs_modulus": "6 kPa", "poisson_ratio": 0.45}
EGG = {"diameters": ["8 mm", "5 mm", "3 mm"], "orientation": [20, 30, 40], "depth": "7 mm", "x": "3 mm", "y": "2 mm"}
LAYERS = [{"thickness": "1.5 mm", "youngs_modulus": "20 kPa", "poisson_ratio": 0.45}, {"thickness": "6 mm", **SOFT}]
SCENES = {
    "grooved, a block, a reference cylinder": (scene(), True),
    "whole, an ellipsoid turned every way": (scene(inclusion=[EGG | {"youngs_modulus": "60 kPa", "poisson_ratio": 0.45}]), False),
    "layers through a tumour": (
        scene(tissue={"shape": "cylinder", "radius": "40 mm", "depth": "30 mm", "layer": LAYERS, **SOFT}),
        True,
    ),
}


@pytest.fixture(scope="module", params=SCENES)
def meshed(request):
    scene_meshed, half = SCENES[request.param]
    layout = build_layout(scene_meshed, half, find_extent(scene_meshed, None), None)
    return mesh_regular_layout(layout, ROUGH_FINENESS), layout


def test_a_regular_mesh_passes_all_checks(meshed):
    mesh, layout = meshed
    check_mesh(mesh, layout)
    assert max(map(abs, compute_errors(mesh, layout).values())) < 0.005
    assert mesh.quality.min() > MIN_QUALITY


def test_tetrahedra_lie_in_the_bodies_they_are_labelled_by(meshed):
    """Middles of tetrahedra, by formulas alone; those beside curved surfaces reach over by less than a tenth of their size."""
    mesh, layout = meshed
    x, y, z = mesh.nodes[mesh.elements[:, :4]].mean(axis=1).T
    r, margin = np.hypot(x, y), 0.2e-3
    inside_block = {MeshBody.INNER: r < layout.inner, MeshBody.OUTER: (r > layout.hole - margin) & (r < layout.tube)}
    inside_block[MeshBody.TISSUE] = (z < 0) & (r < (layout.wall or np.inf))
    inside_block[MeshBody.BEYOND] = (z < 0) & (r > (layout.wall or np.inf) - 1e-3)
    inside_block[MeshBody.GROOVE] = inside_block[MeshBody.OUTER] & (x > 0)
    if layout.groove is not None:
        width, depth = layout.groove
        inside_block[MeshBody.GROOVE] &= (np.abs(y) < width) & (z > layout.outer_height - depth)
    for label, inside in inside_block.items():
        assert inside[mesh.body == label].all()
    for index, body in enumerate(layout.inclusions):
        level = body.level(np.column_stack([x, y, z]))
        assert (level[mesh.body == MeshBody.FIRST_INCLUSION + index] < 1).all()
        assert (level[mesh.body == MeshBody.TISSUE] > 0.8).all()
    bounds = -np.array([0.0, *layout.interfaces, layout.depth])
    layer = np.where(mesh.layer == 0, len(layout.interfaces) + 1, mesh.layer)
    in_tissue = mesh.body >= MeshBody.TISSUE
    assert ((z < bounds[layer - 1]) & (z > bounds[layer]))[in_tissue].all()


def test_nodes_lie_on_the_exact_surfaces(meshed):
    mesh, layout = meshed
    faces = mesh.boundary(MeshBody.INNER)
    r, z = np.hypot(*mesh.nodes[faces][..., :2].T).T, mesh.nodes[faces][..., 2]
    wall = ((z > 1e-9) & (z < layout.inner_height - 1e-9)).any(axis=1)
    if layout.half:
        wall &= (mesh.nodes[faces][..., 1] > 1e-9).any(axis=1)
    assert np.percentile(np.abs(r[wall] - layout.inner), 95) < 1e-9
    assert not layout.half or mesh.nodes[:, 1].min() > -1e-12


def test_netgen_makes_the_same_mesh_again(meshed):
    mesh, layout = meshed
    repeated = mesh_regular_layout(layout, ROUGH_FINENESS)
    assert (mesh.nodes == repeated.nodes).all()
    assert (mesh.elements == repeated.elements).all()


def test_how_many_tetrahedra_there_will_be_is_known(meshed):
    mesh, layout = meshed
    assert 0.6 < len(mesh.elements) / estimate_elements(layout, ROUGH_FINENESS) < 1.5


def test_sizes_are_told_finely_and_everywhere():
    layout = build_layout(scene(), True, 0.1, None)
    sizes = build_shapes(layout, ROUGH_FINENESS).sizes
    rim = np.array([layout.inner, 0.0, 0.0])
    nearest = np.linalg.norm(sizes[:, :3] - rim, axis=1).argmin()
    assert sizes[nearest, 3] < 1.5 * ROUGH_FINENESS.rim * layout.inner
    assert sizes[:, 3].max() > 10 * sizes[:, 3].min()


def test_a_narrow_gap_costs_no_tetrahedra():
    """20 um beside 8 mm."""
    layout = replace(build_layout(scene(), True, 0.1, None), hole=4.02e-3)
    mesh, timing = mesh_layout(layout, ROUGH_FINENESS)
    assert timing.mesher == "netgen"
    assert len(mesh.elements) < 1.5 * estimate_elements(layout, ROUGH_FINENESS)


def test_bodies_from_files_and_hairline_gaps_are_not_regular():
    layout = build_layout(scene(), True, 0.1, None)
    assert is_regular(layout)
    assert not is_regular(replace(layout, hole=4.005e-3))
    assert not is_regular(replace(layout, inclusions=(object(),)))  # type: ignore[arg-type]


def test_netgen_stays_out_of_the_main_process():
    code = "import geometry.tetra.cache, geometry.mesh_programs.glued_shapes, sys; print('netgen' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
