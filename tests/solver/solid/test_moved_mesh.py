"""Meshes carried along with tumours: the bodies are where the scene places them, all else stays; bad meshes are refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geometry.scenes.scene import Scene
from geometry.tetra.body_layout import BodyLayout
from geometry.tetra.layout import build_layout, find_extent
from geometry.tetra.sizing import ROUGH_FINENESS
from geometry.tetra.tet_mesh import MeshBody, TetMesh, compute_volumes
from solver.linalg.workspace import Workspace
from solver.solid.body_stiffness import Part
from solver.solid.domain import choose_domain, compute_reach
from solver.solid.evaluator import SolidEvaluator
from solver.solid.moved_mesh import may_move, move_mesh
from solver.solid.problem import Solid
from tests.support.meshes import SCENE, stored_mesh
from tests.support.references import named

FLANK, ACROSS = named("solid", SCENE).scene, named("tissue-layers-off-axis", "across").scene


def layout(scene: Scene) -> BodyLayout:
    scene_domain = choose_domain(scene, compute_reach(scene), None)
    return build_layout(scene_domain.scene, scene_domain.half, find_extent(scene_domain.scene, None), scene_domain.radius)


def with_first(scene: Scene, **changes: float) -> Scene:
    first, *remaining = scene.inclusion
    return scene.model_copy(update={"inclusion": (first.model_copy(update=changes), *remaining)})


def moved(scene: Scene, name: str, **changes: float) -> TetMesh | None:
    return move_mesh(stored_mesh(name), layout(scene), layout(with_first(scene, **changes)), ROUGH_FINENESS)


@pytest.mark.parametrize("changed", [{"depth": 8e-3}, {"diameter": 7.2e-3}, {"depth": 6.5e-3, "x": FLANK.inclusion[0].x + 5e-4}])
def test_the_tumour_is_where_the_scene_says(changed: dict[str, float]) -> None:
    """Its half's volume and centroid by a ball's formulas: 2/3 pi r^3, 3/8 r from the plane through both axes that cuts it."""
    mesh_found, body = moved(FLANK, "flank-rough", **changed), with_first(FLANK, **changed).inclusion[0]
    assert mesh_found is not None
    assert body.diameter is not None
    radius = body.diameter / 2
    tumour_elements = mesh_found.elements[mesh_found.body == MeshBody.FIRST_INCLUSION]
    volumes = compute_volumes(mesh_found.nodes, tumour_elements)
    assert volumes.sum() == pytest.approx(2 / 3 * np.pi * radius**3, rel=0.005)
    corners = mesh_found.nodes[tumour_elements[:, :4]].mean(axis=1)  # of curved elements nearly their centroids
    centroid = volumes @ corners / volumes.sum()
    assert centroid == pytest.approx([np.hypot(body.x, body.y), 3 / 8 * radius, -body.depth], abs=0.02 * radius)


def test_all_but_tissue_and_tumour_stays_and_hangs_together_as_before() -> None:
    mesh_found, mesh = moved(FLANK, "flank-rough", depth=8e-3), stored_mesh("flank-rough")
    assert mesh_found is not None
    assert np.array_equal(mesh_found.elements, mesh.elements)
    blocks = np.unique(mesh.elements[~np.isin(mesh.body, [MeshBody.TISSUE, MeshBody.BEYOND, MeshBody.FIRST_INCLUSION])])
    assert mesh_found.nodes[blocks] == pytest.approx(mesh.nodes[blocks], abs=1e-12)
    whole = [compute_volumes(tetrahedra.nodes, tetrahedra.elements).sum() for tetrahedra in (mesh_found, mesh)]
    assert whole[0] == pytest.approx(whole[1], rel=1e-4)  # the outside's planes and cylinders


def test_of_a_tumour_that_stays_all_nodes_stay() -> None:
    mesh_found = moved(FLANK, "flank-rough")
    assert mesh_found is not None
    assert mesh_found.nodes == pytest.approx(stored_mesh("flank-rough").nodes, abs=1e-9)


def test_far_ways_and_other_probes_need_another_mesh() -> None:
    own_layout = layout(FLANK)
    assert may_move(own_layout, layout(with_first(FLANK, depth=8e-3)))
    assert not may_move(own_layout, layout(with_first(FLANK, depth=12e-3)))
    assert not may_move(own_layout, replace(own_layout, tube=1.001 * own_layout.tube))
    assert moved(FLANK, "flank-rough", x=FLANK.inclusion[0].x + 2.5e-3) is None  # stretched too much


def test_a_tumour_across_a_plane_that_stays_is_meshed_anew() -> None:
    body = ACROSS.inclusion[0]
    assert moved(ACROSS, "across-rough", depth=body.depth + 5e-4) is None


def test_tissue_becomes_wider_and_blocks_stay() -> None:
    mesh, own_layout = stored_mesh("flank-rough"), layout(FLANK)
    assert own_layout.tissue_radius is not None
    wider = replace(own_layout, tissue_radius=1.05 * own_layout.tissue_radius, depth=1.02 * own_layout.depth)
    mesh_found = move_mesh(mesh, own_layout, wider, ROUGH_FINENESS)
    assert mesh_found is not None
    assert np.hypot(*mesh_found.nodes[:, :2].T).max() == pytest.approx(1.05 * own_layout.tissue_radius)
    assert mesh_found.nodes[:, 2].min() == pytest.approx(-1.02 * own_layout.depth)
    blocks = np.unique(mesh.elements[mesh.body < MeshBody.TISSUE])
    assert mesh_found.nodes[blocks] == pytest.approx(mesh.nodes[blocks], abs=1e-12)


def test_a_layer_becomes_thicker() -> None:
    """The skin above the tumour, by the volume of a half cylinder."""
    mesh, own_layout = stored_mesh("across-rough"), layout(ACROSS)
    skin, *deeper = own_layout.interfaces
    mesh_found = move_mesh(mesh, own_layout, replace(own_layout, interfaces=(1.1 * skin, *deeper)), ROUGH_FINENESS)
    assert mesh_found is not None
    assert own_layout.tissue_radius is not None
    layer_elements = mesh_found.elements[mesh_found.layer == 1]
    assert compute_volumes(mesh_found.nodes, layer_elements).sum() == pytest.approx(
        np.pi / 2 * own_layout.tissue_radius**2 * 1.1 * skin, rel=2e-3
    )


def test_much_thicker_layers_need_another_mesh() -> None:
    own_layout = layout(ACROSS)
    skin, *deeper = own_layout.interfaces
    assert not may_move(own_layout, replace(own_layout, interfaces=(1.5 * skin, *deeper)))


@pytest.mark.slow
def test_bodies_that_stay_are_not_integrated_again() -> None:
    mesh, moved_tetrahedra = stored_mesh("flank-rough"), moved(FLANK, "flank-rough", depth=8e-3)
    assert moved_tetrahedra is not None
    original, moved_solid = Solid.from_mesh(mesh), Solid.from_mesh(moved_tetrahedra)
    continued = Solid.from_mesh(moved_tetrahedra, like=original)
    kept = [body for body in continued.parts if continued.parts[body] is original.parts[body]]
    assert kept
    assert MeshBody.FIRST_INCLUSION not in kept
    for body, part in continued.parts.items():
        assert_alike(part, moved_solid.parts[body])


def assert_alike(first: Part, second: Part) -> None:
    assert np.array_equal(first.rows, second.rows)
    assert first.gram == pytest.approx(second.gram, rel=1e-6, abs=1e-9 * np.abs(second.gram).max())


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_answers_agree_within_their_bounds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The reference, reached from a tumour 1 mm deeper: within the stated error of the independent code, and no mesh is made."""
    monkeypatch.setenv("PROBE_DESIGN_CACHE", str(tmp_path))
    evaluator, reference = SolidEvaluator(workspace=Workspace()), named("solid", SCENE)
    evaluator.evaluate(with_first(FLANK, depth=FLANK.inclusion[0].depth + 1e-3), 0.01)
    made = sorted(tmp_path.iterdir())
    result = evaluator.evaluate(FLANK, 0.01)
    assert sorted(tmp_path.iterdir()) == made
    assert result.ratio is not None
    assert result.error_estimate is not None
    assert abs(result.ratio / reference.ratio - 1) <= result.error_estimate + reference.uncertainty
    assert result.error_estimate <= 0.01
