"""Bessel functions of real numbers and of complex steps, by cubic interpolation of scipy's stored values.

Cubics that match values and derivatives at steps of 1/8 have errors below 3e-7, and their own derivatives are continuous. So a
complex step differentiates exactly the function that is evaluated. The values are stored because importing scipy takes ten times
as long as solving a scene; ``python -m benchmarks.closed_form.tables`` makes them.
"""

from __future__ import annotations

from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from geometry.common.arrays import Floats

Array = Any  # numpy array of floats, or of complex numbers on the way to a derivative
STORED_VALUES_FILE = Path(__file__).with_name("bessel.npy")
STORED_ORDERS = 10  # the orders that ``off_axis`` needs, and one more for the derivative
STEPS_PER_UNIT = 8  # steps of the table per unit of the argument
MAX_ARGUMENT = 1024
VALUES_PER_SLAB = 16384  # values at a time, so that the work arrays stay in the processor's cache


def bessel(x: Array, orders: int = 2, first: int = 0) -> Array:
    """Return the Bessel functions J_first, ..., J_(orders-1) of x, shape (orders - first, *x.shape).

    They are NaN outside 0 to ``MAX_ARGUMENT``; no scene's waves have larger arguments.
    """
    return _interpolate(x, [_fit_cubics(0, order) for order in range(first, orders)])


def compute_spherical_bessel(x: Array, orders: int) -> Array:
    """Return the spherical Bessel functions j_0, ..., j_(orders-1) of x from 0 to ``MAX_ARGUMENT``; shape (orders, *x.shape)."""
    return _interpolate(x, [_fit_cubics(1, order) for order in range(orders)])


def _interpolate(x: Array, tables: list[Any]) -> Array:
    """Return each table's cubics at x, NaN outside the table; shape (tables, *x.shape)."""
    flat = x.reshape(-1)
    outside = ~((flat.real >= 0) & (flat.real < MAX_ARGUMENT))
    if outside.any():
        flat = np.where(outside, 0, flat)
    interpolated = np.empty((len(tables), x.size), dtype=x.dtype)
    for k in range(0, x.size, VALUES_PER_SLAB):
        steps = flat[k : k + VALUES_PER_SLAB] * STEPS_PER_UNIT
        index = steps.real.astype(np.intp)
        fraction = steps - index
        for kind, cubics in zip(interpolated, tables, strict=True):
            value = kind[k : k + VALUES_PER_SLAB]
            np.multiply(cubics[0].take(index, mode="clip"), fraction, out=value)  # without checking bounds anew
            for c in cubics[1:3]:
                value += c.take(index, mode="clip")
                value *= fraction
            value += cubics[3].take(index, mode="clip")
    interpolated[:, outside] = np.nan
    return interpolated.reshape(len(tables), *x.shape)


@lru_cache(maxsize=64)
def _fit_cubics(kind: int, order: int) -> Floats:
    """Fit cubics to the values and derivatives of J_n (kind 0) or j_n (kind 1) at the table's steps.

    The derivatives are (J_(n-1) - J_(n+1)) / 2 and (n j_(n-1) - (n+1) j_(n+1)) / (2n+1). The coefficients are ordered from the
    highest power, shape (4, steps).
    """
    value, next_order = _get_table_values(kind, order), _get_table_values(kind, order + 1)
    if order == 0:
        derivative = -next_order
    else:
        weight = (0.5, 0.5) if kind == 0 else (order / (2 * order + 1), (order + 1) / (2 * order + 1))
        derivative = weight[0] * _get_table_values(kind, order - 1) - weight[1] * next_order
    # Hermite's cubic on each step, in its fraction from 0 to 1: the derivatives are per step
    rise, derivative = np.diff(value), derivative / STEPS_PER_UNIT
    bend = derivative[:-1] + derivative[1:] - 2 * rise
    return np.stack([bend, rise - derivative[:-1] - bend, derivative[:-1], value[:-1]])


def _get_table_values(kind: int, order: int) -> Any:
    """Return J_n (kind 0) or j_n (kind 1) at the steps from 0 to ``MAX_ARGUMENT``, shape (steps + 1,)."""
    return _load_stored_values()[kind, order] if order < STORED_ORDERS else compute_table_values(kind, order)


def compute_table_values(kind: int, order: int) -> Any:
    """Compute J_n (kind 0) or j_n (kind 1) at the table's steps with scipy; scenes need stored orders only."""
    from scipy.special import jv, spherical_jn

    return (jv, spherical_jn)[kind](order, np.arange(MAX_ARGUMENT * STEPS_PER_UNIT + 1.0) / STEPS_PER_UNIT)


@cache
def _load_stored_values() -> Any:
    """Load the stored values of both kinds, shape (2, STORED_ORDERS, steps + 1)."""
    return np.load(STORED_VALUES_FILE)
