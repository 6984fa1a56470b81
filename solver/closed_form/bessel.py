"""Bessel functions of real and, a step away, complex numbers: scipy's values between which cubics lead.

Cubics that meet values and slopes at steps of 1/8 are off by less than 3e-7, and their own derivatives are continuous: what a
complex step differentiates is what is evaluated. A table takes far less time than the cosines and sines of a fit.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.special import jv, jvp, spherical_jn

Array = Any  # numpy array of floats, or of complex numbers on the way to a derivative
STEPS = 8  # of the table, in one
END = 1024
SLAB = 4096  # values at once: what they need then stays in the processor's cache


def bessel(x: Array, orders: int = 2) -> Array:
    """Return J0, J1, ... of x from 0 to ``END``, which no scene's waves reach, NaN elsewhere; shape (orders, *x.shape)."""
    return _between(x, [_cylindrical(order) for order in range(orders)])


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
            value = cubics[0].take(at) * rest
            for c in cubics[1:3]:
                value += c.take(at)
                value *= rest
            kind[k : k + SLAB] = value + cubics[3].take(at)
    interpolated[:, outside] = np.nan
    return interpolated.reshape(len(tables), *x.shape)


@lru_cache(maxsize=32)
def _cylindrical(order: int) -> Any:
    return _cubics(lambda x: jv(order, x), lambda x: jvp(order, x))


@lru_cache(maxsize=32)
def _spherical(order: int) -> Any:
    return _cubics(lambda x: spherical_jn(order, x), lambda x: spherical_jn(order, x, derivative=True))


def _cubics(value: Callable[[Any], Any], slope: Callable[[Any], Any]) -> Any:
    """Coefficients of cubics, highest power first, shape (4, steps)."""
    s = np.arange(END * STEPS + 1.0)
    return CubicHermiteSpline(s, value(s / STEPS), slope(s / STEPS) / STEPS).c
