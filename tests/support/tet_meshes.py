"""What tests measure of tetrahedral meshes."""

from __future__ import annotations

import numpy as np

from geometry.tetra.tet_mesh import TetMesh, element_volumes


def body_volumes(mesh: TetMesh) -> dict[int, float]:
    """Volume in m^3 of each body, of the meshed half where the mesh is one."""
    volumes = element_volumes(mesh.nodes, mesh.elements)
    return {int(label): float(volumes[mesh.body == label].sum()) for label in np.unique(mesh.body)}
