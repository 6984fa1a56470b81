"""Find the largest values that a design file's variable "force" permits, and round loads down."""

from __future__ import annotations

import math

import numpy as np

from geometry.common.arrays import Numeric
from probe_design.populations.entries import DesignVariable

VALUE_TOLERANCE_RELATIVE = 1e-9  # by which a value of the variable "force" may be above an allowed force
LOAD_DIGITS = 3  # significant digits of a load that a limit determines


def find_max_force(variable: DesignVariable) -> float | None:
    """Return the largest force that a design file's variable permits, N; None without an upper bound."""
    return variable.choices[-1] if variable.choices else variable.high


def find_variable_force(variable: DesignVariable, force: Numeric) -> Numeric:
    """Return the largest values of a design file's variable up to forces, N; NaN where there are none.

    Forces are floats or complex, of any shape; values with steps or choices have no derivative.
    """
    size = np.real(force)
    if variable.choices:
        values = np.array([np.nan, *variable.choices])
        return values[np.searchsorted(variable.choices, size * (1 + VALUE_TOLERANCE_RELATIVE), side="right")]
    if variable.step is not None:
        force = np.floor(size / variable.step + VALUE_TOLERANCE_RELATIVE) * variable.step
        force = np.where(force > 0, force, np.nan)
    return force if variable.low is None else np.where(np.real(force) >= variable.low, force, np.nan)


def round_load_down(load: float) -> float:
    """Return the largest load of ``LOAD_DIGITS`` significant digits that is not above a load, N or m."""
    # if rounding to the nearest went up, one unit of the last digit is taken off
    nearest = float(f"{load:.{LOAD_DIGITS}g}")
    if nearest <= load:
        return nearest
    step = 10.0 ** (math.floor(math.log10(load)) + 1 - LOAD_DIGITS)
    return float(f"{nearest - step:.{LOAD_DIGITS}g}")
