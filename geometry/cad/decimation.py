"""Reduce the triangles of surfaces that were scanned finer than a volume mesh can follow."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyvista


MAX_DIRECT_TRIANGLES = 20_000  # triangles up to which pytetwild takes no longer than for a thousand
DECIMATED_TRIANGLES = 10_000
MAX_RELATIVE_DISTANCE = 0.005  # of half the least side of the box around a surface: how far fewer triangles may lie from it


def decimate(surface: pyvista.PolyData) -> tuple[pyvista.PolyData, float] | None:
    """Decimate a surface of more than ``MAX_DIRECT_TRIANGLES`` triangles to ``DECIMATED_TRIANGLES``.

    Quadric error metrics: M. Garland, P. S. Heckbert, Proc. SIGGRAPH 1997, 209-216.

    Parameters
    ----------
    surface
        A ``pyvista.PolyData`` of triangles.

    Returns
    -------
    tuple[pyvista.PolyData, float] | None
        Fewer triangles and how far they are from surface, see ``measure_distance``; None where there are not so many, or where
        fewer do not stay within ``MAX_RELATIVE_DISTANCE``, or are open where the surface is closed.
    """
    if surface.n_cells <= MAX_DIRECT_TRIANGLES:
        return None
    fewer = surface.decimate(1 - DECIMATED_TRIANGLES / surface.n_cells)
    low_x, high_x, low_y, high_y, low_z, high_z = surface.bounds
    allowed = MAX_RELATIVE_DISTANCE * min(high_x - low_x, high_y - low_y, high_z - low_z) / 2
    if fewer.n_cells == 0 or (surface.is_manifold and not fewer.is_manifold):
        return None
    distance = measure_distance(surface, fewer)
    return (fewer, distance) if distance <= allowed else None


def measure_distance(surface: pyvista.PolyData, fewer: pyvista.PolyData) -> float:
    """Return Hausdorff's distance of two surfaces: the largest distance of a point of either from the other.

    It is computed from the corners of the first surface and some dozen points on each triangle of the second.
    """
    from vtkmodules.vtkFiltersModeling import vtkHausdorffDistancePointSetFilter

    measure = vtkHausdorffDistancePointSetFilter()
    measure.SetTargetDistanceMethodToPointToCell()
    measure.SetInputData(0, surface)
    measure.SetInputData(1, fewer.subdivide_adaptive(max_edge_len=math.sqrt(fewer.area / fewer.n_cells) / 2))
    measure.Update()
    return float(measure.GetHausdorffDistance())
