"""Regular scenes by netgen: whole, exact, the same again; bodies checked by what points say that lie in them."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from geometry.tetra.check import LEAST_QUALITY, check, errors
from geometry.tetra.layout import body_layout, extent
from geometry.tetra.mesher import ROUGH, expected_elements, mesh_layout, space_of
from geometry.tetra.regular_mesh import is_regular, regular_mesh, shapes
from geometry.tetra.tet_mesh import BEYOND, GROOVE, INCLUSION, INNER, OUTER, TISSUE
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
    of, half = SCENES[request.param]
    found = body_layout(of, half, extent(of, None), None)
    return regular_mesh(found, ROUGH, space_of(found, ROUGH), 120.0), found


def test_a_regular_mesh_passes_all_checks(meshed):
    mesh, found = meshed
    check(mesh, found)
    assert max(map(abs, errors(mesh, found).values())) < 0.005
    assert mesh.quality.min() > LEAST_QUALITY


def test_tetrahedra_lie_in_the_bodies_they_are_labelled_by(meshed):
    """Middles of tetrahedra, by formulas alone; those beside curved surfaces reach over by less than a tenth of their size."""
    mesh, found = meshed
    x, y, z = mesh.nodes[mesh.elements[:, :4]].mean(axis=1).T
    r, near = np.hypot(x, y), 0.2e-3
    within = {INNER: r < found.inner, OUTER: (r > found.hole - near) & (r < found.tube)}
    within[TISSUE] = (z < 0) & (r < (found.wall or np.inf))
    within[BEYOND] = (z < 0) & (r > (found.wall or np.inf) - 1e-3)
    within[GROOVE] = within[OUTER] & (x > 0)
    if found.groove is not None:
        width, depth = found.groove
        within[GROOVE] &= (np.abs(y) < width) & (z > found.outer_height - depth)
    for label, inside in within.items():
        assert inside[mesh.body == label].all()
    for index, body in enumerate(found.inclusions):
        level = body.level(np.column_stack([x, y, z]))
        assert (level[mesh.body == INCLUSION + index] < 1).all()
        assert (level[mesh.body == TISSUE] > 0.8).all()
    bounds = -np.array([0.0, *found.interfaces, found.depth])
    layer = np.where(mesh.layer == 0, len(found.interfaces) + 1, mesh.layer)
    below = mesh.body >= TISSUE
    assert ((z < bounds[layer - 1]) & (z > bounds[layer]))[below].all()


def test_nodes_lie_on_the_exact_surfaces(meshed):
    mesh, found = meshed
    faces = mesh.boundary(INNER)
    r, z = np.hypot(*mesh.nodes[faces][..., :2].T).T, mesh.nodes[faces][..., 2]
    wall = ((z > 1e-9) & (z < found.inner_height - 1e-9)).any(axis=1)
    if found.half:
        wall &= (mesh.nodes[faces][..., 1] > 1e-9).any(axis=1)
    assert np.percentile(np.abs(r[wall] - found.inner), 95) < 1e-9
    assert not found.half or mesh.nodes[:, 1].min() > -1e-12


def test_netgen_makes_the_same_mesh_again(meshed):
    mesh, found = meshed
    again = regular_mesh(found, ROUGH, space_of(found, ROUGH), 120.0)
    assert (mesh.nodes == again.nodes).all()
    assert (mesh.elements == again.elements).all()


def test_how_many_tetrahedra_there_will_be_is_known(meshed):
    mesh, found = meshed
    assert 0.6 < len(mesh.elements) / expected_elements(found, ROUGH) < 1.5


def test_sizes_are_told_finely_and_everywhere():
    found = body_layout(scene(), True, 0.1, None)
    told = shapes(found, ROUGH, space_of(found, ROUGH)).sizes
    rim = np.array([found.inner, 0.0, 0.0])
    nearest = np.linalg.norm(told[:, :3] - rim, axis=1).argmin()
    assert told[nearest, 3] < 1.5 * ROUGH.rim * found.inner
    assert told[:, 3].max() > 10 * told[:, 3].min()


def test_a_narrow_gap_costs_no_tetrahedra():
    """20 um beside 8 mm."""
    found = replace(body_layout(scene(), True, 0.1, None), hole=4.02e-3)
    mesh, timing = mesh_layout(found, ROUGH)
    assert timing.mesher == "netgen"
    assert len(mesh.elements) < 1.5 * expected_elements(found, ROUGH)


def test_bodies_from_files_and_hairline_gaps_are_not_regular():
    found = body_layout(scene(), True, 0.1, None)
    assert is_regular(found)
    assert not is_regular(replace(found, hole=4.005e-3))
    assert not is_regular(replace(found, inclusions=(object(),)))  # type: ignore[arg-type]


def test_netgen_stays_out_of_the_main_process():
    code = "import geometry.tetra.cache, geometry.mesh_programs.glued_shapes, sys; print('netgen' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
