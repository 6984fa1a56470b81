"""netgen as a program of ``geometry/processes/child.py``: it brings an OpenCASCADE of its own, apart from cadquery's."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from netgen import occ
from netgen.meshing import MeshingParameters

if TYPE_CHECKING:
    from geometry.common.arrays import Arrays, Points


MM_PER_M = 1e3  # OpenCASCADE's margins are absolute, for lengths in mm; ours are in m
_CUTTING_BOX_FACTOR = 4.0  # times the largest length: boxes that cut shapes
_SPHERE_TOLERANCE = 1e-9  # of its largest: an ellipsoid whose semi-axes differ by less is a sphere
_CURVATURE_SAFETY = 2.0  # radii of curvature over edges: with 1.3 some cannot be curved, and volumes are off by percents
_SEGMENTS_PER_EDGE = 0.1  # segments of the shortest edges: sizes say how many there are


def run(arguments: dict[str, Any]) -> Arrays:
    """Mesh what ``geometry.mesh_programs.glued_shapes.GluedShapes`` describes, its fields by name."""
    given = {name: value if value.ndim else value.item() for name, value in arguments.items()}
    parameters = MeshingParameters(
        maxh=float(MM_PER_M * given["sizes"][:, 3].max()),
        grading=given["grading"],
        optsteps3d=given["smoothing"],
        curvaturesafety=_CURVATURE_SAFETY,
        segmentsperedge=_SEGMENTS_PER_EDGE,
        parallel_meshing=False,
    )
    for place in (MM_PER_M * given["sizes"]).tolist():
        parameters.RestrictH(*place)
    mesh = occ.OCCGeometry(occ.Glue(_build_shapes(given))).GenerateMesh(mp=parameters)
    elements = mesh.Elements3D().NumPy()
    corners = elements["nodes"][:, :4].astype(np.int64) - 1
    return {
        "points": np.array(mesh.Coordinates()) / MM_PER_M,
        "tetrahedra": corners[:, [0, 2, 1, 3]],  # turned as VTK turns them
        "piece": elements["index"].astype(np.int64) - 1,
    }


def _build_shapes(given: dict[str, Any]) -> list[occ.TopoDS_Shape]:
    """All shapes, or their halves: what overlaps becomes pieces when they are glued."""
    tubes = [
        _build_cylinder(x, y, low, high, tube) - _build_cylinder(x, y, low, high, hole)
        for x, y, low, high, hole, tube in _rows_in_mm(given["tubes"])
    ]
    tissue = [_build_cylinder(*row) for row in _rows_in_mm(given["cylinders"])] + [
        _build_box(*row) for row in _rows_in_mm(given["boxes"])
    ]
    far = _CUTTING_BOX_FACTOR * MM_PER_M * float(np.abs(given["sizes"][:, :3]).max())
    layers = [tissue[-1] * _build_box(-far, -far, -depth, far, far, far) for depth in (MM_PER_M * given["cuts"]).tolist()]
    grooves = [tubes[0] * _build_box(*row) for row in _rows_in_mm(given["grooves"])]
    bodies = [_build_ellipsoid(MM_PER_M * row[:3], MM_PER_M * row[3:].reshape(3, 3)) for row in given["ellipsoids"]]
    whole = [*tubes, *grooves, *tissue, *layers, *bodies]
    return [shape * _build_box(-far, 0.0, -far, far, far, far) for shape in whole] if given["half"] else whole


def _rows_in_mm(lengths: Points) -> list[list[float]]:
    rows: list[list[float]] = (MM_PER_M * lengths).tolist()
    return rows


def _build_cylinder(x: float, y: float, low: float, high: float, radius: float) -> occ.TopoDS_Shape:
    return occ.Cylinder(occ.Pnt(x, y, low), occ.Z, radius, high - low)


def _build_box(*corners: float) -> occ.TopoDS_Shape:
    return occ.Box(occ.Pnt(*corners[:3]), occ.Pnt(*corners[3:]))


def _build_ellipsoid(centre: Points, axes: Points) -> occ.TopoDS_Shape:
    """A sphere, or an ellipsoid of three semi-axes along the columns of ``axes``."""
    lengths = np.linalg.norm(axes, axis=0)
    middle = occ.Pnt(*centre.tolist())
    if np.ptp(lengths) <= _SPHERE_TOLERANCE * lengths.max():
        return occ.Sphere(middle, float(lengths[0]))
    x, _, z = (axes / lengths).T.tolist()
    return occ.Ellipsoid(occ.Axes(p=middle, n=occ.Dir(*z), h=occ.Dir(*x)), *lengths[[2, 0, 1]].tolist())  # its z comes first
