"""Half-space under rings of pressure and radial shear: the work of each load on the displacements by each other, in closed form.

A disc of radius a under unit pressure has the Hankel transform a J1(ka)/k, one under the shear r has a^2 J2(ka)/k. On an
elastic half-space with shear modulus mu the surface responds to a pressure p and a shear q (outwards) by

    w = [2 (1-nu) p - (1-2nu) q] / (2 mu k),   u = [2 (1-nu) q - (1-2nu) p] / (2 mu k)             (CF.1)

so that the work of one disc's load on the displacement by another's, a <= b and m = (a/b)^2, are integrals of Weber and
Schafheitlin (DLMF 10.22.56):

    pressure, pressure:   2 pi (1-nu)/mu a b Int J1(ka) J1(kb) / k^2 dk,       Int = (a/2) 2F1(1/2, -1/2; 2; m)        (CF.2)
    shear, shear:         2 pi (1-nu)/mu a^2 b^2 Int J2(ka) J2(kb) / k^2 dk,   Int = (a^2/8b) 2F1(3/2, -1/2; 3; m)     (CF.3)
    pressure a, shear b:  -pi (1-2nu)/mu a b^2 Int J1(ka) J2(kb) / k^2 dk,     Int = (a/4) (1 - m/2)                   (CF.4)
    shear a, pressure b:  the same with a and b exchanged,                     Int = a^2/(8b)                          (CF.5)

Near m = 1 both series behave as powers of 1 - m and (1-m)^2 ln(1-m) times powers; that is how they are evaluated, to 1e-9, with
coefficients that ``python -m benchmarks.closed_form.tables`` fits.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from solver.closed_form.bessel import Array

# of 1, 1-m, (1-m)^2, ..., and of (1-m)^2 ln(1-m) times these; a row for eq. CF.2, one for eq. CF.3
SMOOTH_COEFFICIENTS = np.array(
    [
        [0.8488263631567752, 0.21220647065535247, 0.031189412413625252, 0.006030299734585957, -0.03572775378188735,
         -0.05198317025349299, -0.010541621897366208],
        [0.6790610905254201, 0.509294801475629, 0.25130658900670083, 0.17227349986833831, -0.16338416812232615,
         -0.36813753411974115, -0.08041427840727479],
    ]
)  # fmt: skip
LOG_COEFFICIENTS = np.array(
    [
        [0.07954570354798648, 0.09739770490697422, 0.08472206382706339, 0.033964803163423714, 0.0027701325779476943],
        [0.3180387990898221, 0.5390864869706673, 0.5692102310811746, 0.25035743876576055, 0.021288618994470987],
    ]
)
LOG_OFFSET = 1e-200  # keeps the logarithm finite where its factor is zero


def compute_disc_works(circles: Array, radius: Array, mu: Array, nu: Array) -> tuple[Array, Array, Array]:
    """Return the works between discs, eqs. CF.2-CF.5, of pressures, shears, and pressures (rows) on shears.

    They are the works of each disc's load on the displacements by each other disc's load, on a half-space.

    Parameters
    ----------
    circles
        Radii of k discs for each of n designs, increasing, m, shape (n, k).
    radius
        Radius of each disc's block, m, shape (n, k): the shear under the disc is r / radius.
    mu
        Shear modulus of the half-space, shape (n,).
    nu
        Its Poisson's ratio, shape (n,).

    Returns
    -------
    tuple[Array, Array, Array]
        Three arrays of shape (n, k, k).
    """
    size = circles.shape[1]
    low, high = _index_upper_triangle(size)
    rows, shear_radius = circles.T.copy(), radius.T.copy()  # designs last: whole rows are picked and placed
    a, b = rows[low], rows[high]
    complement = (b - a) * (b + a) / (b * b)  # 1 - m without cancellation
    smooth, singular = _evaluate_polynomials(complement, SMOOTH_COEFFICIENTS), _evaluate_polynomials(complement, LOG_COEFFICIENTS)
    series = smooth + complement * complement * np.log(complement + LOG_OFFSET) * singular
    soft, mixed = 2 * np.pi / mu * (1 - nu), -np.pi / mu * (1 - 2 * nu)
    square = a * a  # and no higher power: numpy is slow with those
    pressure = soft / 2 * square * b * series[0]
    shear = soft / 8 * square * square * b / (shear_radius[low] * shear_radius[high]) * series[1]
    cross = np.empty((size, size, len(mu)), dtype=complement.dtype)
    cross[low, high] = mixed / 8 * square * b * b / shear_radius[high] * (1 + complement)  # eq. CF.4
    cross[high, low] = mixed / 8 * square * square / shear_radius[low]  # eq. CF.5
    return _fill_symmetric(pressure, size), _fill_symmetric(shear, size), cross.transpose(2, 0, 1)


@lru_cache(maxsize=4)
def _index_upper_triangle(size: int) -> tuple[Any, Any]:
    """Return the rows and columns of a matrix's upper triangle, the diagonal included."""
    return np.triu_indices(size)


def _fill_symmetric(values: Array, size: int) -> Array:
    """Build symmetric matrices, shape (n, size, size), from their upper triangles, shape (entries, n)."""
    low, high = _index_upper_triangle(size)
    full = np.empty((size, size, values.shape[1]), dtype=values.dtype)
    full[low, high] = full[high, low] = values
    return full.transpose(2, 0, 1)


def _evaluate_polynomials(x: Array, coefficients: Floats) -> Array:
    """Evaluate several polynomials (rows of coefficients, lowest power first) at x; shape (polynomials, *x.shape)."""
    # powers by products of lower ones: numpy is slow with ``**``
    powers = np.empty((coefficients.shape[1], x.size), dtype=x.dtype)
    powers[0], powers[1] = 1, x.ravel()
    for k in range(2, len(powers)):
        np.multiply(powers[k // 2], powers[k - k // 2], out=powers[k])
    return (coefficients @ powers).reshape(len(coefficients), *x.shape)
