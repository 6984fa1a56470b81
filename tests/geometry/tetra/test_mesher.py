import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from geometry import Refusal, SolveError
from geometry.processes.child import Failure, TooLong
from geometry.tetra import mesher as module
from geometry.tetra.layout import build_layout, find_extent, is_mirror_symmetric
from geometry.tetra.mesh_check import MIN_QUALITY, check_mesh, compute_errors, find_max_error
from geometry.tetra.mesher import mesh_layout
from geometry.tetra.sizing import COARSE_FINENESS, FINE_FINENESS, ROUGH_FINENESS
from geometry.tetra.stretched_space import choose_mesh_space
from geometry.tetra.tet_mesh import MeshBody, build_quadratic, compute_volumes
from tests.support.scenes import block_scene as scene


@pytest.fixture(scope="module")
def grooved():
    layout = build_layout(scene(), True, 0.1, None)
    return (*mesh_layout(layout, ROUGH_FINENESS), layout)


def test_every_volume_and_area_is_the_scenes(grooved):
    mesh, _, layout = grooved
    assert len(compute_errors(mesh, layout)) == 11
    assert max(map(abs, compute_errors(mesh, layout).values())) < 0.01
    assert find_max_error(mesh, layout) < 3e-3


def test_bodies_are_labelled_and_apart(grooved):
    mesh, _, _ = grooved
    assert set(mesh.body.tolist()) == {
        MeshBody.INNER,
        MeshBody.OUTER,
        MeshBody.GROOVE,
        MeshBody.TISSUE,
        MeshBody.BEYOND,
        MeshBody.FIRST_INCLUSION,
    }
    inner, outer = (
        np.unique(mesh.elements[np.isin(mesh.body, bodies)]) for bodies in ([MeshBody.INNER], [MeshBody.OUTER, MeshBody.GROOVE])
    )
    assert len(np.intersect1d(inner, outer)) == 0
    assert (mesh.beyond == (mesh.body == MeshBody.BEYOND)).all()


def test_a_rough_mesh_is_small_and_no_element_folds(grooved):
    mesh, _, _ = grooved
    assert 2_500 < len(mesh.elements) < 8_000
    assert mesh.quality.min() > MIN_QUALITY
    assert np.percentile(mesh.quality, 1) > 0.03


def test_nodes_lie_on_the_exact_surfaces(grooved):
    mesh, _, layout = grooved
    faces = mesh.boundary(MeshBody.INNER)
    r, z = np.hypot(*mesh.nodes[faces][..., :2].T).T, mesh.nodes[faces][..., 2]
    wall = ((z > 1e-9) & (z < layout.inner_height - 1e-9)).any(axis=1) & (mesh.nodes[faces][..., 1] > 1e-9).any(axis=1)
    assert np.percentile(np.abs(r[wall] - layout.inner), 95) < 1e-9
    assert mesh.nodes[:, 1].min() > -1e-12


def test_a_mesh_that_is_not_the_scenes_is_refused(grooved):
    mesh, _, layout = grooved
    lost = replace(mesh, body=np.where(mesh.body == MeshBody.FIRST_INCLUSION, MeshBody.TISSUE, mesh.body))
    with pytest.raises(SolveError, match=r"inclusion\[0\]'s volume"):
        check_mesh(lost, layout)
    squeezed = mesh.nodes.copy()
    squeezed[mesh.elements[7, 0]] = mesh.nodes[mesh.elements[7, 1]]
    with pytest.raises(SolveError, match="folded"):
        check_mesh(replace(mesh, nodes=squeezed), layout)


def test_each_fineness_is_finer_everywhere():
    for coarser, finer in ((ROUGH_FINENESS, COARSE_FINENESS), (COARSE_FINENESS, FINE_FINENESS)):
        for name in ("groove", "rim", "block", "wall", "sphere", "layer", "growth"):
            assert getattr(finer, name) < 0.8 * getattr(coarser, name)


EMPTY = SimpleNamespace(inclusions=(), inner=1.0, gap=1.0)
IRREGULAR = SimpleNamespace(inclusions=("a body from a file",), inner=1.0, gap=1.0)


class TestTrials:
    """What ``mesh_layout`` does with meshes that are made up."""

    def meshes(self, monkeypatch, *outcomes, name="TETWILD"):
        left, seen = list(outcomes), []

        def trial(layout, fineness, number):
            seen.append((name, fineness.rim))
            if isinstance(left[0], Exception):
                raise left.pop(0)
            return left.pop(0)

        monkeypatch.setattr(module, f"{name}_MESHER", module.Mesher(name.lower(), trial))
        monkeypatch.setattr(module, "check_mesh", lambda mesh, layout: None)
        monkeypatch.setattr(module, "find_max_error", lambda mesh, layout: mesh)
        return seen

    def test_the_best_of_three_is_kept(self, monkeypatch):
        seen = self.meshes(monkeypatch, 8e-3, 4e-3, 6e-3)
        mesh, timing = mesh_layout(IRREGULAR, COARSE_FINENESS)
        assert (mesh, timing.trials, timing.mesher) == (4e-3, 3, "tetwild")
        assert seen[0][1] > seen[1][1] > seen[2][1]

    def test_a_good_one_is_taken_at_once(self, monkeypatch):
        self.meshes(monkeypatch, 2e-3)
        assert mesh_layout(IRREGULAR, COARSE_FINENESS)[1].trials == 1

    def test_a_crash_is_tried_again(self, monkeypatch):
        self.meshes(monkeypatch, Failure("SIGSEGV"), SolveError("folded"), 4e-3)
        assert mesh_layout(IRREGULAR, COARSE_FINENESS)[0] == 4e-3

    def test_a_run_that_takes_too_long_is_tried_once_more(self, monkeypatch):
        self.meshes(monkeypatch, TooLong("it took longer than 240 s"), 2e-3)
        assert mesh_layout(IRREGULAR, COARSE_FINENESS)[0] == 2e-3

    def test_two_runs_that_take_too_long_are_enough(self, monkeypatch):
        seen = self.meshes(monkeypatch, TooLong("it took longer than 240 s"), TooLong("it took longer than 600 s"))
        with pytest.raises(SolveError, match="longer than 600 s"):
            mesh_layout(IRREGULAR, COARSE_FINENESS)
        assert len(seen) == 2

    def test_a_regular_scene_is_not_left_to_pytetwild(self, monkeypatch):
        seen = self.meshes(monkeypatch, 8e-3, 2e-3, name="NETGEN")
        assert mesh_layout(EMPTY, COARSE_FINENESS)[1].mesher == "netgen"
        assert len(seen) == 2

    def test_pytetwild_meshes_where_netgen_cannot(self, monkeypatch):
        failed = self.meshes(monkeypatch, SolveError("folded"), Failure("SIGSEGV"), SolveError("lost"), name="NETGEN")
        self.meshes(monkeypatch, 2e-3)
        assert mesh_layout(EMPTY, COARSE_FINENESS)[1].mesher == "tetwild"
        assert len(failed) == 3


def test_half_of_a_scene_without_symmetry_is_refused():
    lopsided = scene(placement={"x": "0 mm", "y": "1 mm"})
    assert is_mirror_symmetric(scene())
    assert not is_mirror_symmetric(lopsided)
    with pytest.raises(Refusal, match="mirror image"):
        build_layout(lopsided, True, math.inf, None)


@pytest.mark.parametrize("radius", [3e-3, 40e-3])
def test_a_reference_cylinder_has_to_lie_between_probe_and_sides(radius):
    with pytest.raises(Refusal, match="reference_radius"):
        build_layout(scene(), True, 0.1, radius)


def test_the_reference_cylinder_avoids_inclusions():
    far = {"diameter": "6 mm", "depth": "9 mm", "x": "18 mm", "youngs_modulus": "60 kPa", "poisson_ratio": 0.45}
    layout = build_layout(scene(inclusion=[far]), True, 0.1, None)
    assert layout.wall is not None
    assert layout.wall < 15e-3 or layout.wall > 21e-3


def test_the_space_of_the_mesher_is_mapped_back_exactly():
    space = choose_mesh_space(4e-3, 4.02e-3, 6e-3, gap=0.5e-3, linear_radius=8e-3, height=3e-3, rise=1e-3)
    points = np.random.default_rng(1).normal(scale=20e-3, size=(500, 3))
    restored = space.to_scene(space.to_mesh(points))
    assert np.abs(restored - points).max() < 1e-12
    ends = space.to_mesh(np.array([[4e-3, 0, 0], [4.02e-3, 0, 0]]))
    assert ends[1, 0] - ends[0, 0] == pytest.approx(0.5e-3)
    points_above = space.to_mesh(np.array([[4e-3, 0, 3e-3], [4.02e-3, 0, 3e-3]]))
    assert points_above[1, 0] - points_above[0, 0] > 1e-3


def test_volumes_of_curved_elements_are_exact_for_an_affine_map():
    corners = np.vstack([np.zeros(3), np.eye(3)])
    nodes, elements, pairs = build_quadratic(corners, np.array([[0, 1, 2, 3]]))
    assert len(pairs) == 6
    assert compute_volumes(nodes, elements)[0] == pytest.approx(1 / 6)


def test_a_half_space_ends_beyond_all_bodies():
    soft = {"shape": "half-space", "youngs_modulus": "6 kPa", "poisson_ratio": 0.45}
    far = scene(tissue=soft)
    layout = build_layout(far, True, find_extent(far, None), None)
    assert layout.tissue_radius == layout.depth >= 25 * layout.tube
    assert layout.wall is None
    assert math.isclose(find_extent(far, 0.2), 0.2)


@pytest.mark.parametrize(
    "shape", [{"shape": "cylinder", "radius": "60 mm"}, {"shape": "block", "length": "90 mm", "breadth": "80 mm"}]
)
def test_shortened_tissue_is_a_cylinder_round_the_probe(shape):
    soft = {"depth": "70 mm", "youngs_modulus": "6 kPa", "poisson_ratio": 0.45}
    large = scene(tissue={**shape, **soft}, placement={"x": "2 mm"})
    layout = build_layout(large, True, 0.03, None)
    assert (layout.centre, layout.tissue_radius, layout.depth, layout.wall) == ((0.0, 0.0), 0.03, 0.03, None)
    assert build_layout(large, True, find_extent(large, None), None).depth == 0.07
    assert build_layout(large, True, find_extent(large, None), None).wall is not None
    assert build_layout(large, True, 0.03, 0.02).wall == 0.02


def test_tissue_within_the_extent_stays_but_for_its_depth():
    layout = build_layout(scene(), True, 0.0395, None)
    assert (layout.tissue_radius, layout.sides, layout.depth) == (None, (0.03, 0.025), 0.0395)


@pytest.mark.parametrize(("extent", "reason"), [(9e-3, "inclusion.0."), (5e-3, "above")])
def test_shortened_tissue_has_room_for_probe_and_inclusions(extent, reason):
    with pytest.raises(Refusal, match=f"tissue_extent.*{reason}"):
        build_layout(scene(), True, extent, None)


def test_a_half_space_has_to_end_somewhere():
    soft = {"shape": "half-space", "youngs_modulus": "6 kPa", "poisson_ratio": 0.45}
    with pytest.raises(Refusal, match="tissue_extent"):
        build_layout(scene(tissue=soft), True, math.inf, None)
