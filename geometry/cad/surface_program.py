"""Read triangles of an STL or STEP file in a child process (``geometry/processes/child.py``): damaged files crash their readers.

OpenCASCADE ends a process by signal 11 over some, and reads others without an end; VTK reads STL and takes points together.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyvista

from geometry.cad.decimation import decimate
from geometry.cad.solids import load_cadquery

if TYPE_CHECKING:
    from geometry.common.arrays import Arrays

RELATIVE_DEFLECTION = 0.002  # of a STEP surface's diagonal: how far its triangles may lie from it
MAX_TURN_RAD = 0.2  # rad: by how much neighbouring triangles' normals may differ


def run(arguments: Arrays) -> Arrays:
    """Read the file ``name`` (of kind ".stl", ".step" or ".stp" by its ``suffix``).

    Returns
    -------
    Arrays
        Points (n, 3), mm, and triangles (t, 3); if there are very many, also ``few_points`` and ``few_triangles`` of a coarser
        surface and ``off``, its distance from the file's surface, mm: see ``geometry.cad.decimation.decimate``.
    """
    read = _read_stl if arguments["suffix"].item() == ".stl" else _read_step
    poly = read(arguments["name"].item()).clean(tolerance=1e-7)  # both formats give each face points of its own
    fewer = decimate(poly)
    return _to_arrays(poly) if fewer is None else {**_to_arrays(poly), **_to_arrays(fewer[0], "few_"), "off": np.array(fewer[1])}


def _to_arrays(poly: pyvista.PolyData, prefix: str = "") -> Arrays:
    """Return points (n, 3) and triangles (t, 3) of a surface, by these names after a prefix."""
    points, triangles = np.asarray(poly.points, dtype=float), np.asarray(poly.regular_faces, dtype=np.int64)
    return {f"{prefix}points": points, f"{prefix}triangles": triangles}


def _read_stl(name: str) -> pyvista.PolyData:
    """Read the triangles of an STL file."""
    surface: pyvista.PolyData = pyvista.read(name, force_ext=".stl").triangulate()
    return surface


def _read_step(name: str) -> pyvista.PolyData:
    """Read a STEP file, and approximate its surface by triangles."""
    shape = load_cadquery().importers.importStep(name).val()
    vertices, triangles = shape.tessellate(RELATIVE_DEFLECTION * shape.BoundingBox().DiagonalLength, MAX_TURN_RAD)
    points = np.array([vertex.toTuple() for vertex in vertices], dtype=float)
    surface: pyvista.PolyData = pyvista.PolyData.from_regular_faces(points, triangles)
    return surface
