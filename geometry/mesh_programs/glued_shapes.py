"""Mesh regular shapes given by numbers: OpenCASCADE divides them exactly into pieces, and netgen (Schoeberl, 1997) meshes these.

netgen is deterministic: the same shapes and sizes give the same mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points
from geometry.common.resources import find_seconds_left, get_limits
from geometry.processes.programs import run_program

_PROGRAM = Path(__file__).with_name("netgen_program.py")
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Pieces:
    """Straight-sided tetrahedra of shapes that are glued together.

    Attributes
    ----------
    points
        (n, 3) in m.
    tetrahedra
        (t, 4) in VTK's order.
    piece
        Number of the piece that each tetrahedron lies in, (t,), from 0.
    """

    points: Points
    tetrahedra: Indices
    piece: Indices


@dataclass(frozen=True)
class GluedShapes:
    """Shapes that may overlap, in m; each connected region that lies in the same shapes is a piece.

    Attributes
    ----------
    cylinders
        Vertical cylinders: x, y, lower and upper z, radius; (k, 5).
    tubes
        Vertical tubes: x, y, lower and upper z, radius of the hole, outer radius; (k, 6).
    boxes
        Lower and upper corners, (k, 6).
    grooves
        Boxes that cut the first tube in two, (k, 6).
    ellipsoids
        Centre, and the matrix whose columns are the semi-axes, row by row, (k, 12).
    cuts
        Depths of planes that cut the last box, or the last cylinder if there is none, (k,).
    half
        Whether only y >= 0 is meshed.
    sizes
        Points and the maximum edge lengths there, (k, 4).
    grading
        Netgen's grading, from 0 to 1: how fast edge lengths may grow.
    smoothing
        Number of netgen's optimisation steps.
    curvature_safety
        Smallest radius of curvature over edge length.
    """

    cylinders: Points
    tubes: Points
    boxes: Points
    grooves: Points
    ellipsoids: Points
    cuts: Points
    half: bool
    sizes: Points
    grading: float
    smoothing: int
    curvature_safety: float

    def mesh(self, patience: float) -> Pieces:
        """Mesh all pieces in a child process that uses one core and ends after ``patience`` s.

        Raises
        ------
        TooLong, Failure, KeyboardInterrupt
            See ``geometry.processes.programs.run_program``.
        """
        arrays = {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}
        return Pieces(**run_program(_PROGRAM, arrays, min(patience, find_seconds_left()), get_limits().memory))
