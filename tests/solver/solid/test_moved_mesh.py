"""Meshes carried along with tumours: the bodies are where the scene says, all else stays; what would be no good mesh is none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geometry.scenes.scene import Scene
from geometry.tetra.layout import BodyLayout, body_layout, extent
from geometry.tetra.sizing import ROUGH
from geometry.tetra.tet_mesh import BEYOND, INCLUSION, TISSUE, TetMesh, element_volumes
from solver.linalg.workspace import Workspace
from solver.solid.body_stiffness import Part
from solver.solid.domain import domain, reach
from solver.solid.level import SolidLevel
from solver.solid.moved_mesh import may_move, moved_mesh
from solver.solid.problem import Solid
from tests.support.meshes import SCENE, stored_mesh
from tests.support.references import named

FLANK, ACROSS = named("solid", SCENE).scene, named("tissue-layers-off-axis", "across").scene


def layout(scene: Scene) -> BodyLayout:
    of = domain(scene, reach(scene), None)
    return body_layout(of.scene, of.half, extent(of.scene, None), of.radius)


def with_first(scene: Scene, **other: float) -> Scene:
    first, *rest = scene.inclusion
    return scene.model_copy(update={"inclusion": (first.model_copy(update=other), *rest)})


def moved(scene: Scene, name: str, **other: float) -> TetMesh | None:
    return moved_mesh(stored_mesh(name), layout(scene), layout(with_first(scene, **other)), ROUGH)


@pytest.mark.parametrize("changed", [{"depth": 8e-3}, {"diameter": 7.2e-3}, {"depth": 6.5e-3, "x": FLANK.inclusion[0].x + 5e-4}])
def test_the_tumour_is_where_the_scene_says(changed: dict[str, float]) -> None:
    """Its half's volume and centroid by a ball's formulas: 2/3 pi r^3, 3/8 r from the plane through both axes that cuts it."""
    found, body = moved(FLANK, "flank-rough", **changed), with_first(FLANK, **changed).inclusion[0]
    assert found is not None
    assert body.diameter is not None
    radius = body.diameter / 2
    own = found.elements[found.body == INCLUSION]
    volumes = element_volumes(found.nodes, own)
    assert volumes.sum() == pytest.approx(2 / 3 * np.pi * radius**3, rel=0.005)
    corners = found.nodes[own[:, :4]].mean(axis=1)  # of curved elements nearly their centroids
    centroid = volumes @ corners / volumes.sum()
    assert centroid == pytest.approx([np.hypot(body.x, body.y), 3 / 8 * radius, -body.depth], abs=0.02 * radius)


def test_all_but_tissue_and_tumour_stays_and_hangs_together_as_before() -> None:
    found, mesh = moved(FLANK, "flank-rough", depth=8e-3), stored_mesh("flank-rough")
    assert found is not None
    assert np.array_equal(found.elements, mesh.elements)
    blocks = np.unique(mesh.elements[~np.isin(mesh.body, [TISSUE, BEYOND, INCLUSION])])
    assert found.nodes[blocks] == pytest.approx(mesh.nodes[blocks], abs=1e-12)
    whole = [element_volumes(one.nodes, one.elements).sum() for one in (found, mesh)]
    assert whole[0] == pytest.approx(whole[1], rel=1e-4)  # the outside's planes and cylinders


def test_of_a_tumour_that_stays_all_nodes_stay() -> None:
    found = moved(FLANK, "flank-rough")
    assert found is not None
    assert found.nodes == pytest.approx(stored_mesh("flank-rough").nodes, abs=1e-9)


def test_far_ways_and_other_probes_need_another_mesh() -> None:
    here = layout(FLANK)
    assert may_move(here, layout(with_first(FLANK, depth=8e-3)))
    assert not may_move(here, layout(with_first(FLANK, depth=12e-3)))
    assert not may_move(here, replace(here, tube=1.001 * here.tube))
    assert moved(FLANK, "flank-rough", x=FLANK.inclusion[0].x + 2.5e-3) is None  # stretched too much


def test_a_tumour_across_a_plane_that_stays_is_meshed_anew() -> None:
    body = ACROSS.inclusion[0]
    assert moved(ACROSS, "across-rough", depth=body.depth + 5e-4) is None


def test_tissue_becomes_wider_and_blocks_stay() -> None:
    mesh, here = stored_mesh("flank-rough"), layout(FLANK)
    assert here.tissue_radius is not None
    wider = replace(here, tissue_radius=1.05 * here.tissue_radius, depth=1.02 * here.depth)
    found = moved_mesh(mesh, here, wider, ROUGH)
    assert found is not None
    assert np.hypot(*found.nodes[:, :2].T).max() == pytest.approx(1.05 * here.tissue_radius)
    assert found.nodes[:, 2].min() == pytest.approx(-1.02 * here.depth)
    blocks = np.unique(mesh.elements[mesh.body < TISSUE])
    assert found.nodes[blocks] == pytest.approx(mesh.nodes[blocks], abs=1e-12)


def test_a_layer_becomes_thicker() -> None:
    """The skin above the tumour, by the volume of a half cylinder."""
    mesh, here = stored_mesh("across-rough"), layout(ACROSS)
    skin, *others = here.interfaces
    found = moved_mesh(mesh, here, replace(here, interfaces=(1.1 * skin, *others)), ROUGH)
    assert found is not None
    assert here.tissue_radius is not None
    own = found.elements[found.layer == 1]
    assert element_volumes(found.nodes, own).sum() == pytest.approx(np.pi / 2 * here.tissue_radius**2 * 1.1 * skin, rel=2e-3)


def test_much_thicker_layers_need_another_mesh() -> None:
    here = layout(ACROSS)
    skin, *others = here.interfaces
    assert not may_move(here, replace(here, interfaces=(1.5 * skin, *others)))


def test_bodies_that_stay_are_not_integrated_again() -> None:
    mesh, found = stored_mesh("flank-rough"), moved(FLANK, "flank-rough", depth=8e-3)
    assert found is not None
    before, own = Solid.of(mesh), Solid.of(found)
    after = Solid.of(found, like=before)
    kept = [body for body in after.parts if after.parts[body] is before.parts[body]]
    assert kept
    assert INCLUSION not in kept
    for body, part in after.parts.items():
        assert_alike(part, own.parts[body])


def assert_alike(one: Part, other: Part) -> None:
    assert np.array_equal(one.rows, other.rows)
    assert one.gram == pytest.approx(other.gram, rel=1e-6, abs=1e-9 * np.abs(other.gram).max())


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_answers_agree_within_their_bounds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The reference, reached from a tumour 1 mm deeper: within the stated error of the independent code, and no mesh is made."""
    monkeypatch.setenv("PROBE_DESIGN_CACHE", str(tmp_path))
    level, one = SolidLevel(workspace=Workspace()), named("solid", SCENE)
    level.evaluate(with_first(FLANK, depth=FLANK.inclusion[0].depth + 1e-3), 0.01)
    made = sorted(tmp_path.iterdir())
    found = level.evaluate(FLANK, 0.01)
    assert sorted(tmp_path.iterdir()) == made
    assert found.ratio is not None
    assert found.error_estimate is not None
    assert abs(found.ratio / one.ratio - 1) <= found.error_estimate + one.uncertainty
    assert found.error_estimate <= 0.01
