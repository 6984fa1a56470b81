import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from geometry import Refusal, SolveError
from geometry.common.child_process import Failure, TooLong
from geometry.tetra import mesher as module
from geometry.tetra.check import LEAST_QUALITY, check, errors, largest_error
from geometry.tetra.layout import Ellipsoid, body_layout, extent, mirror_symmetric
from geometry.tetra.mesher import COARSE, FINE, ROUGH, mesh_layout
from geometry.tetra.stretched_space import mesh_space
from geometry.tetra.surfaces import ellipsoid
from geometry.tetra.tet_mesh import BEYOND, GROOVE, INCLUSION, INNER, OUTER, TISSUE, element_volumes, quadratic
from tests.support.scenes import block_scene as scene


@pytest.fixture(scope="module")
def grooved():
    found = body_layout(scene(), True, 0.1, None)
    return (*mesh_layout(found, ROUGH), found)


def test_every_volume_and_area_is_the_scenes(grooved):
    mesh, _, found = grooved
    assert len(errors(mesh, found)) == 11
    assert max(map(abs, errors(mesh, found).values())) < 0.01
    assert largest_error(mesh, found) < 3e-3


def test_bodies_are_labelled_and_apart(grooved):
    mesh, _, _ = grooved
    assert set(mesh.body.tolist()) == {INNER, OUTER, GROOVE, TISSUE, BEYOND, INCLUSION}
    inner, outer = (np.unique(mesh.elements[np.isin(mesh.body, bodies)]) for bodies in ([INNER], [OUTER, GROOVE]))
    assert len(np.intersect1d(inner, outer)) == 0
    assert (mesh.beyond == (mesh.body == BEYOND)).all()


def test_a_rough_mesh_is_small_and_no_element_folds(grooved):
    mesh, _, _ = grooved
    assert 2_500 < len(mesh.elements) < 8_000
    assert mesh.quality.min() > LEAST_QUALITY
    assert np.percentile(mesh.quality, 1) > 0.03


def test_nodes_lie_on_the_exact_surfaces(grooved):
    mesh, _, found = grooved
    faces = mesh.boundary(INNER)
    r, z = np.hypot(*mesh.nodes[faces][..., :2].T).T, mesh.nodes[faces][..., 2]
    wall = ((z > 1e-9) & (z < found.inner_height - 1e-9)).any(axis=1) & (mesh.nodes[faces][..., 1] > 1e-9).any(axis=1)
    assert np.percentile(np.abs(r[wall] - found.inner), 95) < 1e-9
    assert mesh.nodes[:, 1].min() > -1e-12


def test_a_mesh_that_is_not_the_scenes_is_refused(grooved):
    mesh, _, found = grooved
    lost = replace(mesh, body=np.where(mesh.body == INCLUSION, TISSUE, mesh.body))
    with pytest.raises(SolveError, match=r"inclusion\[0\]'s volume"):
        check(lost, found)
    squeezed = mesh.nodes.copy()
    squeezed[mesh.elements[7, 0]] = mesh.nodes[mesh.elements[7, 1]]
    with pytest.raises(SolveError, match="folded"):
        check(replace(mesh, nodes=squeezed), found)


def test_each_fineness_is_finer_everywhere():
    for coarser, finer in ((ROUGH, COARSE), (COARSE, FINE)):
        for name in ("groove", "rim", "block", "wall", "sphere", "layer", "growth"):
            assert getattr(finer, name) < 0.8 * getattr(coarser, name)
        assert finer.corners > coarser.corners


EMPTY = SimpleNamespace(inclusions=(), inner=1.0, gap=1.0)
IRREGULAR = SimpleNamespace(inclusions=("a body from a file",), inner=1.0, gap=1.0)


class TestTrials:
    """What ``mesh_layout`` does with meshes that are made up."""

    def meshes(self, monkeypatch, *outcomes, name="TETWILD"):
        left, seen = list(outcomes), []

        def trial(found, fineness, number):
            seen.append((name, fineness.rim))
            if isinstance(left[0], Exception):
                raise left.pop(0)
            return left.pop(0)

        monkeypatch.setattr(module, name, module.Mesher(name.lower(), trial))
        monkeypatch.setattr(module, "check", lambda mesh, found: None)
        monkeypatch.setattr(module, "largest_error", lambda mesh, found: mesh)
        return seen

    def test_the_best_of_three_is_kept(self, monkeypatch):
        seen = self.meshes(monkeypatch, 8e-3, 4e-3, 6e-3)
        mesh, timing = mesh_layout(IRREGULAR, COARSE)
        assert (mesh, timing.trials, timing.mesher) == (4e-3, 3, "tetwild")
        assert seen[0][1] > seen[1][1] > seen[2][1]

    def test_a_good_one_is_taken_at_once(self, monkeypatch):
        self.meshes(monkeypatch, 2e-3)
        assert mesh_layout(IRREGULAR, COARSE)[1].trials == 1

    def test_a_crash_is_tried_again(self, monkeypatch):
        self.meshes(monkeypatch, Failure("SIGSEGV"), SolveError("folded"), 4e-3)
        assert mesh_layout(IRREGULAR, COARSE)[0] == 4e-3

    def test_a_run_that_takes_too_long_is_tried_once_more(self, monkeypatch):
        self.meshes(monkeypatch, TooLong("it took longer than 240 s"), 2e-3)
        assert mesh_layout(IRREGULAR, COARSE)[0] == 2e-3

    def test_two_runs_that_take_too_long_are_enough(self, monkeypatch):
        seen = self.meshes(monkeypatch, TooLong("it took longer than 240 s"), TooLong("it took longer than 600 s"))
        with pytest.raises(SolveError, match="longer than 600 s"):
            mesh_layout(IRREGULAR, COARSE)
        assert len(seen) == 2

    def test_a_regular_scene_is_not_left_to_pytetwild(self, monkeypatch):
        seen = self.meshes(monkeypatch, 8e-3, 2e-3, name="NETGEN")
        assert mesh_layout(EMPTY, COARSE)[1].mesher == "netgen"
        assert len(seen) == 2

    def test_pytetwild_meshes_where_netgen_cannot(self, monkeypatch):
        failed = self.meshes(monkeypatch, SolveError("folded"), Failure("SIGSEGV"), SolveError("lost"), name="NETGEN")
        self.meshes(monkeypatch, 2e-3)
        assert mesh_layout(EMPTY, COARSE)[1].mesher == "tetwild"
        assert len(failed) == 3


def test_half_of_a_scene_without_symmetry_is_refused():
    lopsided = scene(placement={"x": "0 mm", "y": "1 mm"})
    assert mirror_symmetric(scene())
    assert not mirror_symmetric(lopsided)
    with pytest.raises(Refusal, match="mirror image"):
        body_layout(lopsided, True, math.inf, None)


@pytest.mark.parametrize("radius", [3e-3, 40e-3])
def test_a_reference_cylinder_has_to_lie_between_probe_and_sides(radius):
    with pytest.raises(Refusal, match="reference_radius"):
        body_layout(scene(), True, 0.1, radius)


def test_the_reference_cylinder_avoids_inclusions():
    far = {"diameter": "6 mm", "depth": "9 mm", "x": "18 mm", "youngs_modulus": "60 kPa", "poisson_ratio": 0.45}
    found = body_layout(scene(inclusion=[far]), True, 0.1, None)
    assert found.wall is not None
    assert found.wall < 15e-3 or found.wall > 21e-3


def test_the_space_of_the_mesher_is_mapped_back_exactly():
    space = mesh_space(4e-3, 4.02e-3, 6e-3, gap=0.5e-3, near=8e-3, height=3e-3, rise=1e-3)
    points = np.random.default_rng(1).normal(scale=20e-3, size=(500, 3))
    back = space.to_scene(space.to_mesh(points))
    assert np.abs(back - points).max() < 1e-12
    ends = space.to_mesh(np.array([[4e-3, 0, 0], [4.02e-3, 0, 0]]))
    assert ends[1, 0] - ends[0, 0] == pytest.approx(0.5e-3)
    above = space.to_mesh(np.array([[4e-3, 0, 3e-3], [4.02e-3, 0, 3e-3]]))
    assert above[1, 0] - above[0, 0] > 1e-3


def test_volumes_of_curved_elements_are_exact_for_an_affine_map():
    corners = np.vstack([np.zeros(3), np.eye(3)])
    nodes, elements, pairs = quadratic(corners, np.array([[0, 1, 2, 3]]))
    assert len(pairs) == 6
    assert element_volumes(nodes, elements)[0] == pytest.approx(1 / 6)


@pytest.mark.parametrize("half", [True, False])
def test_an_ellipsoids_triangles_lie_on_it(half):
    body = Ellipsoid(np.array([1.0, 0, -3]), np.array([[0.8, 0, 0.6], [0, 2.0, 0], [-0.6, 0, 0.8]]))
    points, triangles = ellipsoid(body, 6, half)
    assert body.level(points) == pytest.approx(1)
    a, b, c = (points[triangles[:, k]] - body.centre for k in range(3))
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
    assert abs(volume) == pytest.approx(body.volume / (2 if half else 1), rel=0.05)
    assert not half or points[:, 1].min() > -1e-12


def test_a_half_space_ends_beyond_all_bodies():
    soft = {"shape": "half-space", "youngs_modulus": "6 kPa", "poisson_ratio": 0.45}
    far = scene(tissue=soft)
    found = body_layout(far, True, extent(far, None), None)
    assert found.tissue_radius == found.depth >= 25 * found.tube
    assert found.wall is None
    assert math.isclose(extent(far, 0.2), 0.2)


@pytest.mark.parametrize(
    "shape", [{"shape": "cylinder", "radius": "60 mm"}, {"shape": "block", "length": "90 mm", "breadth": "80 mm"}]
)
def test_shortened_tissue_is_a_cylinder_round_the_probe(shape):
    soft = {"depth": "70 mm", "youngs_modulus": "6 kPa", "poisson_ratio": 0.45}
    large = scene(tissue={**shape, **soft}, placement={"x": "2 mm"})
    found = body_layout(large, True, 0.03, None)
    assert (found.centre, found.tissue_radius, found.depth, found.wall) == ((0.0, 0.0), 0.03, 0.03, None)
    assert body_layout(large, True, extent(large, None), None).depth == 0.07
    assert body_layout(large, True, extent(large, None), None).wall is not None
    assert body_layout(large, True, 0.03, 0.02).wall == 0.02


def test_tissue_within_the_extent_stays_but_for_its_depth():
    found = body_layout(scene(), True, 0.0395, None)
    assert (found.tissue_radius, found.sides, found.depth) == (None, (0.03, 0.025), 0.0395)


@pytest.mark.parametrize(("extent", "reason"), [(9e-3, "inclusion.0."), (5e-3, "above")])
def test_shortened_tissue_has_room_for_probe_and_inclusions(extent, reason):
    with pytest.raises(Refusal, match=f"tissue_extent.*{reason}"):
        body_layout(scene(), True, extent, None)


def test_a_half_space_has_to_end_somewhere():
    soft = {"shape": "half-space", "youngs_modulus": "6 kPa", "poisson_ratio": 0.45}
    with pytest.raises(Refusal, match="tissue_extent"):
        body_layout(scene(tissue=soft), True, math.inf, None)
