"""Make the meshes of tests/meshes with netgen.

Duration: seconds.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from netgen.occ import Box, Cylinder, Glue, OCCGeometry, Pnt, Sphere, Z
from ngsolve import Mesh

from geometry.tetra.tet_mesh import EDGE_CORNERS, MeshBody

MESHES = Path(__file__).parents[2] / "tests" / "meshes"
HALF = Box(Pnt(-500, 0, -500), Pnt(500, 500, 500))


def probe() -> Any:
    """Half a probe on round tissue, mm, and what lies beyond the reference cylinder."""
    tube = Cylinder((0, 0, 0), Z, 6, 3) - Cylinder((0, 0, 0), Z, 4.1, 3)
    groove = Box(Pnt(0, -1, 2), Pnt(12, 1, 3)) * tube
    sphere = Sphere(Pnt(3, 0, -6), 2.5)
    tissue = Cylinder((0, 0, -16), Z, 16, 16)
    margin = Cylinder((0, 0, -16), Z, 20, 16) - tissue
    bodies: dict[int, Any] = {
        MeshBody.INNER: Cylinder((0, 0, 0), Z, 4, 3),
        MeshBody.OUTER: tube - groove,
        MeshBody.GROOVE: groove,
        MeshBody.TISSUE: tissue - sphere,
    }
    shape = Glue(list(_name_bodies({**bodies, MeshBody.BEYOND: margin, MeshBody.FIRST_INCLUSION: sphere})))
    for edge in shape.edges:
        low, high = edge.bounding_box
        if max(abs(low.z), abs(high.z)) < 1e-6 and max(abs(low.x), abs(high.x)) < 6.01:
            edge.maxh = 0.9
    return shape


def _name_bodies(bodies: dict[int, Any]) -> Iterable[Any]:
    for label, body in bodies.items():
        for part in (body * HALF).solids:
            part.mat(str(label))
            part.maxh = 100 if label in (MeshBody.TISSUE, MeshBody.BEYOND) else 2
            yield part


def cylinder(size: float) -> Any:
    """Build a cylinder of unit radius and height, finer at its two edges."""
    shape = Cylinder((0, 0, 0), Z, 1, 1)
    shape.mat(str(MeshBody.TISSUE))
    for edge in shape.edges:
        low, high = edge.bounding_box
        if abs(low.z - high.z) < 1e-6:
            edge.maxh = size / 2
    return shape


def write(name: str, shape: Any, size: float, unit: float = 1.0, half: bool = False) -> None:
    netgen_mesh = OCCGeometry(shape).GenerateMesh(maxh=size, grading=0.6 if half else 0.4, optsteps3d=3)
    mesh = Mesh(netgen_mesh)
    mesh.Curve(2)
    netgen_mesh.SecondOrder()
    points = np.array([point.p for point in netgen_mesh.Points()])
    elements = np.array([[node.nr - 1 for node in item.points] for item in netgen_mesh.Elements3D()])
    body = np.array([int(mesh.GetMaterials()[item.index - 1]) for item in netgen_mesh.Elements3D()])
    used, numbers = np.unique(_vtk(points, elements), return_inverse=True)
    data = {
        "nodes": unit * points[used],
        "elements": numbers.reshape(elements.shape).astype(np.int16),
        "body": body.astype(np.int8),
    }
    np.savez_compressed(MESHES / f"{name}.npz", half=half, **data)


def _vtk(points: Any, elements: Any) -> Any:
    """Netgen's corners turned to the right hand, and its middles sorted to VTK's edges by where they are."""
    corners = elements[:, [0, 2, 1, 3]]
    distances = points[corners][:, EDGE_CORNERS].mean(axis=2)[:, :, None] - points[elements[:, 4:]][:, None]
    nearest = np.linalg.norm(distances, axis=3).argmin(axis=2)
    return np.hstack([corners, np.take_along_axis(elements[:, 4:], nearest, axis=1)])


if __name__ == "__main__":
    write("probe", probe(), 7, 1e-3, half=True)
    write("bonded-coarse", cylinder(0.5), 0.5)
    write("bonded-fine", cylinder(0.25), 0.25)
