"""pytetwild as a program of ``geometry/processes/child.py``: it is slow at times without an end, and may crash."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from geometry.common.arrays import Arrays, Points


def run(arguments: Arrays) -> Arrays:
    """Call ``pytetwild.tetrahedralize`` with arguments by name, arrays of any dimension; points (n, 3), tetrahedra (t, 4)."""
    options = {name: value if value.ndim else value.item() for name, value in arguments.items()}
    points, tetrahedra = _load_pytetwild()(**options, num_threads=1, quiet=True, vtk_ordering=True)
    return {"points": points, "tetrahedra": tetrahedra}


def _load_pytetwild() -> Callable[..., tuple[Points, NDArray[np.int32]]]:
    """``pytetwild.tetrahedralize``, without the half second for pyvista if it can do without."""
    sys.modules["pyvista"] = ModuleType("pyvista")
    try:
        from pytetwild.pytetwild import tetrahedralize
    except (ImportError, AttributeError):
        for name in [name for name in sys.modules if name.startswith(("pyvista", "pytetwild"))]:
            del sys.modules[name]
        from pytetwild.pytetwild import tetrahedralize
    return tetrahedralize
