"""Regular shapes as numbers, and their mesh: netgen (Schoeberl, 1997) meshes the pieces that OpenCASCADE makes of them exactly.

netgen draws no lots: the same shapes and sizes have the same mesh.
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
    """Straight tetrahedra of shapes glued together.

    Attributes:
        points: (n, 3) in m.
        tetrahedra: (t, 4) in VTK's order.
        piece: which piece each lies in, (t,), from 0 on.
    """

    points: Points
    tetrahedra: Indices
    piece: Indices


@dataclass(frozen=True)
class GluedShapes:
    """Shapes that may overlap, in m; each part of space that lies in the same ones, and hangs together, is a piece.

    Attributes:
        cylinders: about vertical axes: x, y, lower and upper z, radius; (k, 5).
        tubes: likewise with two radii, the hole's first, (k, 6).
        boxes: lower and upper corners, (k, 6).
        grooves: boxes that cut the first tube in two, (k, 6).
        ellipsoids: middle and semi-axes, the columns of a matrix by rows, (k, 12).
        cuts: depths of planes that cut the last box, or the last cylinder if there is none, (k,).
        half: whether only y >= 0 is meshed.
        sizes: points and the lengths that edges may have there, (k, 4).
        grading: how fast these may grow, 0 to 1.
        smoothing: rounds of netgen's improvement of the mesh.
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

    def mesh(self, patience: float) -> Pieces:
        """Mesh all pieces in a process that takes one core; ``patience`` in s.

        Raises:
            TooLong, Failure, KeyboardInterrupt: see ``geometry.processes.programs.run_program``.
        """
        arrays = {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}
        return Pieces(**run_program(_PROGRAM, arrays, min(patience, find_seconds_left()), get_limits().memory))
