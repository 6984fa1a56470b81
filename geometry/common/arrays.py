"""Types of arrays that every package uses."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Points = NDArray[np.float64]
"""Coordinates, m: the last axis is x, y, z."""
Arrays = dict[str, NDArray[Any]]
"""Arrays by name, as programs in child processes take and return them."""
Numeric = Any
"""A float, complex number, array or casadi expression, in formulas that serve all of them."""
