"""Run netgen as a program of ``geometry/processes/child.py``: it contains its own OpenCASCADE, separate from cadquery's."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from netgen import occ
from netgen.meshing import MeshingParameters

from geometry.common.json_types import JsonObject

if TYPE_CHECKING:
    from geometry.common.arrays import Arrays, Points


MM_PER_M = 1e3  # OpenCASCADE's tolerances are absolute and made for lengths in mm; lengths here are in m
_CUTTING_BOX_FACTOR = 4.0  # edge of the boxes that cut shapes, over the largest length
_SPHERE_TOLERANCE = 1e-9  # relative: an ellipsoid whose semi-axes differ by less is a sphere
_SEGMENTS_PER_EDGE = 0.1  # netgen's segments per edge: so few that the requested sizes decide


def run(arguments: JsonObject) -> Arrays:
    """Mesh the shapes given by the fields of ``geometry.mesh_programs.glued_shapes.GluedShapes``, by name."""
    given = {name: value if value.ndim else value.item() for name, value in arguments.items()}
    parameters = MeshingParameters(
        maxh=float(MM_PER_M * given["sizes"][:, 3].max()),
        grading=given["grading"],
        optsteps3d=given["smoothing"],
        curvaturesafety=given["curvature_safety"],
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
        "tetrahedra": corners[:, [0, 2, 1, 3]],  # VTK's orientation
        "piece": elements["index"].astype(np.int64) - 1,
    }


def _build_shapes(given: JsonObject) -> list[occ.TopoDS_Shape]:
    """Build all shapes, or their halves; overlaps become pieces when the shapes are glued."""
    tubes = [
        _build_cylinder(x, y, low, high, tube) - _build_cylinder(x, y, low, high, hole)
        for x, y, low, high, hole, tube in _convert_rows_to_mm(given["tubes"])
    ]
    tissue = [_build_cylinder(*row) for row in _convert_rows_to_mm(given["cylinders"])] + [
        _build_box(*row) for row in _convert_rows_to_mm(given["boxes"])
    ]
    far = _CUTTING_BOX_FACTOR * MM_PER_M * float(np.abs(given["sizes"][:, :3]).max())
    layers = [tissue[-1] * _build_box(-far, -far, -depth, far, far, far) for depth in (MM_PER_M * given["cuts"]).tolist()]
    grooves = [tubes[0] * _build_box(*row) for row in _convert_rows_to_mm(given["grooves"])]
    bodies = [_build_ellipsoid(MM_PER_M * row[:3], MM_PER_M * row[3:].reshape(3, 3)) for row in given["ellipsoids"]]
    whole = [*tubes, *grooves, *tissue, *layers, *bodies]
    return [shape * _build_box(-far, 0.0, -far, far, far, far) for shape in whole] if given["half"] else whole


def _convert_rows_to_mm(lengths: Points) -> list[list[float]]:
    """Return the rows of an array of lengths in m as lists, in mm."""
    rows: list[list[float]] = (MM_PER_M * lengths).tolist()
    return rows


def _build_cylinder(x: float, y: float, low: float, high: float, radius: float) -> occ.TopoDS_Shape:
    """Build a vertical cylinder between two heights."""
    return occ.Cylinder(occ.Pnt(x, y, low), occ.Z, radius, high - low)


def _build_box(*corners: float) -> occ.TopoDS_Shape:
    """Build a box from its lower and its upper corner, six coordinates."""
    return occ.Box(occ.Pnt(*corners[:3]), occ.Pnt(*corners[3:]))


def _build_ellipsoid(centre: Points, axes: Points) -> occ.TopoDS_Shape:
    """Build a sphere, or an ellipsoid whose three semi-axes are the columns of ``axes``."""
    lengths = np.linalg.norm(axes, axis=0)
    middle = occ.Pnt(*centre.tolist())
    if np.ptp(lengths) <= _SPHERE_TOLERANCE * lengths.max():
        return occ.Sphere(middle, float(lengths[0]))
    x, _, z = (axes / lengths).T.tolist()
    return occ.Ellipsoid(occ.Axes(p=middle, n=occ.Dir(*z), h=occ.Dir(*x)), *lengths[[2, 0, 1]].tolist())  # its z comes first
