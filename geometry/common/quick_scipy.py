"""Import SciPy's sparse matrices in half the time.

SciPy copies NumPy's namespace when it is imported, and so imports every submodule that NumPy would import at its first use: f2py,
testing, masked arrays and polynomials, which nothing here calls. They are hidden meanwhile, and can be used as before.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

UNUSED_SUBMODULES = frozenset({"ctypeslib", "f2py", "ma", "polynomial", "testing"})  # of NumPy, by SciPy's sparse matrices


@contextmanager
def hide_submodules() -> Iterator[None]:
    """Leave unused submodules of NumPy out of what ``dir`` and ``import *`` list, inside the block."""
    names, list_names = np.__all__, np.__dir__
    np.__all__ = [name for name in names if name not in UNUSED_SUBMODULES]
    np.__dir__ = lambda: [name for name in list_names() if name not in UNUSED_SUBMODULES]  # type: ignore[method-assign]
    try:
        yield
    finally:
        np.__all__, np.__dir__ = names, list_names  # type: ignore[method-assign]


if "scipy.sparse" not in sys.modules:
    with hide_submodules():
        import scipy.sparse.linalg  # noqa: F401
