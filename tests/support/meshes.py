"""Meshes of tetrahedra that tests share, in tests/meshes, so that only meshing's own tests mesh.

Those of `scene_mesh` are made anew by ``python -m tests.support.meshes [NAME ...]``, the others by
benchmarks/references/solid_meshes.py.
"""

from __future__ import annotations

import sys
from functools import cache

import numpy as np

from geometry.scenes.scene_file import read_scene
from geometry.tetra.body_layout import BodyLayout
from geometry.tetra.layout import build_layout, find_extent
from geometry.tetra.mesh_check import check_mesh
from geometry.tetra.mesher import mesh_layout
from geometry.tetra.sizing import COARSE_FINENESS, ROUGH_FINENESS, ROUGHEST_FINENESS, TetraFineness
from geometry.tetra.tet_mesh import MeshBody, TetMesh, compute_volumes
from solver.solid.domain import Domain, choose_domain, compute_reach
from tests.support.paths import MESHES, REFERENCE

SCENE = "flank"  # of tests/reference/solid: half of it is meshed
LAYERED = "across"  # of tests/reference/tissue-layers-off-axis, likewise
FOLDERS = {SCENE: "solid", LAYERED: "tissue-layers-off-axis"}
FINENESS = {ROUGHEST_FINENESS: "roughest", ROUGH_FINENESS: "rough", COARSE_FINENESS: "coarse"}


@cache
def stored_mesh(name: str) -> TetMesh:
    """Read one of tests/meshes."""
    data = np.load(MESHES / f"{name}.npz")
    body = data["body"].astype(np.int64)
    layer = data["layer"].astype(np.int64) if "layer" in data else np.zeros(len(body), dtype=np.int64)
    return TetMesh(data["nodes"], data["elements"].astype(np.int64), body, body == MeshBody.BEYOND, layer, bool(data["half"]))


def scene_mesh(scene_domain: Domain, fineness: TetraFineness, name: str = SCENE) -> TetMesh:
    """What domain_mesh.mesh_domain returns, of a scene with the bodies of a named one; ``check`` holds that it is."""
    mesh = stored_mesh(f"{name}-{FINENESS[fineness]}")
    check_mesh(mesh, _layout(scene_domain))
    return mesh


def body_volumes(mesh: TetMesh) -> dict[int, float]:
    """Volume in m^3 of each body, of the meshed half where the mesh is one."""
    volumes = compute_volumes(mesh.nodes, mesh.elements)
    return {int(label): float(volumes[mesh.body == label].sum()) for label in np.unique(mesh.body)}


def _layout(scene_domain: Domain) -> BodyLayout:
    return build_layout(scene_domain.scene, scene_domain.half, find_extent(scene_domain.scene, None), scene_domain.radius)


def main() -> None:
    for scene_name in sys.argv[1:] or FOLDERS:
        scene = read_scene(REFERENCE / FOLDERS[scene_name] / f"{scene_name}.toml")
        scene_domain = choose_domain(scene, compute_reach(scene), None)
        for fineness, name in FINENESS.items():
            mesh, _ = mesh_layout(_layout(scene_domain), fineness)
            assert np.array_equal(mesh.beyond, mesh.body == MeshBody.BEYOND)
            small = {"elements": mesh.elements.astype(np.uint16)} | {
                key: getattr(mesh, key).astype(np.int8) for key in ("body", "layer")
            }
            np.savez_compressed(MESHES / f"{scene_name}-{name}.npz", nodes=mesh.nodes, half=np.array(mesh.half), **small)


if __name__ == "__main__":
    main()
