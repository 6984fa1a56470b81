"""Bessel functions of real and, a step away, complex numbers: scipy's values between which cubics lead.

Cubics that meet values and slopes at steps of 1/8 are off by less than 3e-7, and their own derivatives are continuous: what a
complex step differentiates is what is evaluated. A table takes far less time than the cosines and sines of a fit. The values
are stored, as importing scipy takes ten times as long as a scene; ``python -m benchmarks.closed_form.tables`` makes them.
"""

from __future__ import annotations

from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

Array = Any  # numpy array of floats, or of complex numbers on the way to a derivative
STORED = Path(__file__).with_name("bessel.npy")
STORED_ORDERS = 10  # those of ``off_axis``, and one more for the slope
STEPS = 8  # of the table, in one
END = 1024
SLAB = 16384  # values at once: what they need then stays in the processor's cache


def bessel(x: Array, orders: int = 2, first: int = 0) -> Array:
    """Return J0, J1, ..., from ``first`` on, of x from 0 to ``END``, NaN elsewhere; shape (orders - first, *x.shape).

    No scene's waves reach further.
    """
    return _between(x, [_cylindrical(order) for order in range(first, orders)])


def spherical(x: Array, orders: int) -> Array:
    """Return the spherical Bessel functions j0, j1, ... likewise."""
    return _between(x, [_spherical(order) for order in range(orders)])


def _between(x: Array, tables: list[Any]) -> Array:
    flat = x.reshape(-1)
    outside = ~((flat.real >= 0) & (flat.real < END))
    if outside.any():
        flat = np.where(outside, 0, flat)
    interpolated = np.empty((len(tables), x.size), dtype=x.dtype)
    for k in range(0, x.size, SLAB):
        steps = flat[k : k + SLAB] * STEPS
        at = steps.real.astype(np.intp)
        rest = steps - at
        for kind, cubics in zip(interpolated, tables, strict=True):
            value = kind[k : k + SLAB]
            np.multiply(cubics[0].take(at, mode="clip"), rest, out=value)  # without checking bounds anew
            for c in cubics[1:3]:
                value += c.take(at, mode="clip")
                value *= rest
            value += cubics[3].take(at, mode="clip")
    interpolated[:, outside] = np.nan
    return interpolated.reshape(len(tables), *x.shape)


@lru_cache(maxsize=32)
def _cylindrical(order: int) -> Any:
    """Cubics of J_n, whose slope is (J_n-1 - J_n+1) / 2."""
    before = _values(0, order - 1) if order else -_values(0, 1)
    return _cubics(_values(0, order), (before - _values(0, order + 1)) / 2)


@lru_cache(maxsize=32)
def _spherical(order: int) -> Any:
    """Cubics of j_n, whose slope is j_n-1 - (n+1) j_n / x; at 0 it is 1/3 for j_1, none for others."""
    value = _values(1, order)
    if order == 0:
        return _cubics(value, -_values(1, 1))
    x = np.arange(1.0, END * STEPS + 1) / STEPS
    return _cubics(value, np.append(1 / 3 if order == 1 else 0.0, _values(1, order - 1)[1:] - (order + 1) * value[1:] / x))


def _cubics(value: Any, slope: Any) -> Any:
    """Coefficients of the cubics from step to step that meet values and slopes, highest power first, shape (4, steps)."""
    rise, slope = np.diff(value), slope / STEPS
    bend = slope[:-1] + slope[1:] - 2 * rise
    return np.stack([bend, rise - slope[:-1] - bend, slope[:-1], value[:-1]])


def _values(kind: int, order: int) -> Any:
    """J_n, kind 0, or j_n, kind 1, at the steps from 0 to ``END``, shape (steps + 1,)."""
    return _stored()[kind, order] if order < STORED_ORDERS else made(kind, order)


def made(kind: int, order: int) -> Any:
    """Return the same by scipy, which stored orders, all that scenes need, do without."""
    from scipy.special import jv, spherical_jn

    return (jv, spherical_jn)[kind](order, np.arange(END * STEPS + 1.0) / STEPS)


@cache
def _stored() -> Any:
    """The orders of both kinds, shape (2, STORED_ORDERS, steps + 1)."""
    return np.load(STORED)
