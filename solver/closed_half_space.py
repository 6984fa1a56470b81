"""Half-space under rings of pressure and radial shear: the displacements' work on each other, in closed form.

A disc of radius a under unit pressure has the Hankel transform a J1(ka)/k, one under the shear r has a^2 J2(ka)/k. On an
elastic half-space with shear modulus mu the surface answers a pressure p and a shear q (outwards) by

    w = [2 (1-nu) p - (1-2nu) q] / (2 mu k),   u = [2 (1-nu) q - (1-2nu) p] / (2 mu k)             (H1)

so that the work of one disc's load on the displacement by another's, a <= b and m = (a/b)^2, are integrals of Weber and
Schafheitlin (DLMF 10.22.56):

    pressure, pressure:   2 pi (1-nu)/mu a b Int J1(ka) J1(kb) / k^2 dk,       Int = (a/2) 2F1(1/2, -1/2; 2; m)        (H2)
    shear, shear:         2 pi (1-nu)/mu a^2 b^2 Int J2(ka) J2(kb) / k^2 dk,   Int = (a^2/8b) 2F1(3/2, -1/2; 3; m)     (H3)
    pressure a, shear b:  -pi (1-2nu)/mu a b^2 Int J1(ka) J2(kb) / k^2 dk,     Int = (a/4) (1 - m/2)                   (H4)
    shear a, pressure b:  the same with a and b exchanged,                     Int = a^2/(8b)                          (H5)

Near m = 1 both series behave as powers of 1 - m and (1-m)^2 ln(1-m) times powers; that is how they are evaluated.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from scipy.special import hyp2f1

from solver.bessel import Array

SMOOTH, SINGULAR = 9, 7  # terms of both parts: errors below 1e-9
TINY = 1e-200  # keeps the logarithm finite where its factor is zero


def ring_work(circles: Array, radius: Array, mu: Array, nu: Array) -> tuple[Array, Array, Array]:
    """Return the works between discs, eqs. (H2)-(H5), of pressures, shears, and pressures (rows) on shears.

    Args:
        circles: increasing radii, shape (n, k).
        radius: the shears are r / radius; shape (n, k).
        mu: shear modulus of the half-space, shape (n,).
        nu: its Poisson's ratio, shape (n,).

    Returns:
        three arrays of shape (n, k, k).
    """
    low, high = _pairs(circles.shape[1])
    a, b = circles[:, low], circles[:, high]
    rest = (b - a) * (b + a) / b**2  # 1 - m without cancellation
    series = [_series(rest, *_coefficients(c)) for c in (2, 3)]
    scale = (np.pi / mu)[:, None]
    soft, mixed = 2 * scale * (1 - nu)[:, None], -scale * (1 - 2 * nu)[:, None]
    both = radius[:, low] * radius[:, high]
    square = a**2  # and no higher power: numpy is slow with those
    pressure = soft * square * b / 2 * series[0]
    shear = soft * square**2 * b / (8 * both) * series[1]
    small_pressure = mixed * square * b**2 / (8 * radius[:, high]) * (1 + rest)
    small_shear = mixed * square**2 / (8 * radius[:, low])
    size = circles.shape[1]
    cross = _placed(small_pressure, size, low, high)
    cross[:, high, low] = small_shear
    return _both(pressure, size, low, high), _both(shear, size, low, high), cross


def _pairs(size: int) -> tuple[Any, Any]:
    return np.triu_indices(size)


def _placed(values: Array, size: int, low: Any, high: Any) -> Array:
    full = np.zeros((len(values), size, size), dtype=values.dtype)
    full[:, low, high] = values
    return full


def _both(values: Array, size: int, low: Any, high: Any) -> Array:
    full = _placed(values, size, low, high)
    full[:, high, low] = values
    return full


def _series(rest: Array, smooth: Any, singular: Any) -> Array:
    return _powers(rest, smooth) + rest**2 * np.log(rest + TINY) * _powers(rest, singular)


def _powers(x: Array, coefficients: Any) -> Array:
    total = coefficients[-1] + 0 * x
    for coefficient in coefficients[-2::-1]:
        total = total * x + coefficient
    return total


@lru_cache(maxsize=2)
def _coefficients(c: int) -> tuple[Any, Any]:
    """Powers of 1 - m that make up 2F1(c - 3/2, -1/2; c; m), fitted to scipy's, exact at m = 1."""
    rest = (1 - np.cos(np.linspace(0, np.pi, 400))) / 2
    values = hyp2f1(c - 1.5, -0.5, c, 1 - rest)
    powers = rest[:, None] ** np.arange(1, SMOOTH)
    logs = (rest**2 * np.log(rest + TINY))[:, None] * rest[:, None] ** np.arange(SINGULAR)
    fit = np.linalg.lstsq(np.hstack([powers, logs]), values - values[0], rcond=None)[0]
    return np.concatenate([values[:1], fit[: SMOOTH - 1]]), fit[SMOOTH - 1 :]
