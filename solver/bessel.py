"""J0 and J1 of real and, a step away, complex numbers: one fit, smooth from 0 to infinity.

With s = 1 / sqrt(1 + x^2),

    J0 = sqrt(s) [A(s) cos x + x s B(s) sin x],   J1 = sqrt(s) [C(s) sin x + x s D(s) cos x]          (J1)

has the form of Bessel's series at 0 and of Hankel's expansion at infinity (DLMF 10.17.3). Powers of s up to 6 bring the
error, times sqrt(x), below 2e-6.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from scipy.special import j0, j1

Array = Any  # numpy array of floats, or of complex numbers on the way to a derivative
DEGREE = 6
SLAB = 4096  # values at once: what they need then stays in the processor's cache


def bessel(x: Array) -> tuple[Array, Array]:
    """Return J0 and J1 of x >= 0."""
    found = np.empty((2, x.size), dtype=x.dtype)
    flat = x.reshape(-1)
    for k in range(0, x.size, SLAB):
        found[:, k : k + SLAB] = _bessel(flat[k : k + SLAB])
    return found[0].reshape(x.shape), found[1].reshape(x.shape)


def _bessel(x: Array) -> tuple[Array, Array]:
    s = 1 / np.sqrt(1 + x * x)
    even, odd, wave = np.cos(x), np.sin(x), np.sqrt(s)
    tilt = x * s
    A, B, C, D = power_series(s, _fit())
    return wave * (A * even + tilt * B * odd), wave * (C * odd + tilt * D * even)


def power_series(x: Array, coefficients: Any) -> Array:
    """Values of several polynomials, rows of coefficients, at x; shape (polynomials, *x.shape)."""
    powers = np.empty((coefficients.shape[1], x.size), dtype=x.dtype)
    powers[0], powers[1] = 1, x.ravel()
    for k in range(2, len(powers)):
        np.multiply(powers[k // 2], powers[k - k // 2], out=powers[k])
    return (coefficients @ powers).reshape(len(coefficients), *x.shape)


@lru_cache(maxsize=1)
def _fit() -> Any:
    """Coefficients of A, B, C, D by least squares; rows."""
    x = np.concatenate([np.linspace(0, 12, 2000), np.geomspace(12, 1e4, 2000)])
    s = 1 / np.sqrt(1 + x**2)
    powers = s[:, None] ** np.arange(DEGREE + 1)
    rows: list[Any] = []
    for exact, first, second in ((j0(x), np.cos(x), np.sin(x)), (j1(x), np.sin(x), np.cos(x))):
        terms = np.hstack([powers * first[:, None], powers * (x * s * second)[:, None]])
        rows += np.split(np.linalg.lstsq(terms, exact / np.sqrt(s), rcond=None)[0], 2)
    return np.array(rows)
