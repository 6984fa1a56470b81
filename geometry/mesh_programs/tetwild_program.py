"""Run pytetwild as a program of ``geometry/processes/child.py``, since it sometimes does not end, and may crash."""

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
    """Return points (n, 3) and tetrahedra (t, 4) from ``pytetwild.tetrahedralize``, called with arguments by name."""
    options = {name: value if value.ndim else value.item() for name, value in arguments.items()}
    points, tetrahedra = _load_pytetwild()(**options, num_threads=1, quiet=True, vtk_ordering=True)
    return {"points": points, "tetrahedra": tetrahedra}


def _load_pytetwild() -> Callable[..., tuple[Points, NDArray[np.int32]]]:
    """Return ``pytetwild.tetrahedralize``, if possible without the half second that importing pyvista takes."""
    sys.modules["pyvista"] = ModuleType("pyvista")
    try:
        from pytetwild.pytetwild import tetrahedralize
    except (ImportError, AttributeError):
        for name in [name for name in sys.modules if name.startswith(("pyvista", "pytetwild"))]:
            del sys.modules[name]
        from pytetwild.pytetwild import tetrahedralize
    return tetrahedralize
