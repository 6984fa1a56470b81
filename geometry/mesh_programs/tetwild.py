"""Mesh surfaces that need not be watertight with pytetwild (Hu et al., 2020); its meshes differ from run to run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points
from geometry.common.resources import find_seconds_left, get_limits
from geometry.processes.programs import run_program

_PROGRAM = Path(__file__).with_name("tetwild_program.py")


def tetrahedralize(arrays: Mapping[str, object], patience: float) -> tuple[Points, NDArray[np.int64]]:
    """Call ``pytetwild.tetrahedralize`` in a child process that uses one core; several threads may call it at once.

    Parameters
    ----------
    arrays
        Arguments of ``tetrahedralize`` by name, arrays or numbers.
    patience
        Seconds after which the process is ended, unless the limits of the evaluation end it sooner.

    Returns
    -------
    tuple[Points, NDArray[np.int64]]
        Points (n, 3) in the unit of the given points, and tetrahedra (t, 4) in VTK's order.

    Raises
    ------
    TooLong, Failure, KeyboardInterrupt
        See ``geometry.processes.programs.run_program``.
    """
    mesh = run_program(_PROGRAM, arrays, min(patience, find_seconds_left()), get_limits().memory)
    return mesh["points"], mesh["tetrahedra"].astype(np.int64)
