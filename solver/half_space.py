"""Elastic half-space and layer under uniform pressure on discs, in casadi expressions.

Every function takes and returns casadi ``SX`` (or floats), so that it can be evaluated fast
and differentiated exactly. Lengths in m; ``nu`` is Poisson's ratio, ``E`` Young's modulus.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

SX = Any  # casadi is untyped: an SX scalar, or a float

AGM_STEPS = 6  # quadratic convergence: 6 steps reach rounding for moduli down to 1 - m = 1e-12
ANGLES = 12  # of the mean over the disc's edge; spectral as long as the depth is not small beside the radius


def work(a: SX, b: SX, E: SX, nu: SX) -> SX:
    """Work of disc a's unit pressure on the displacement by disc b's, concentric, a <= b; m^5/N.

    Eq. (H1): W = 4 pi (1-nu^2)/E a b Int J1(ka) J1(kb) / k^2 dk, the integral being
    (a/2) 2F1(1/2, -1/2; 2; m), m = (a/b)^2 (Weber-Schafheitlin; DLMF 10.22.56), which is
    2a/(3 pi m) [(1+m) E(m) - (1-m) K(m)].
    """
    m = (a / b) ** 2
    first, second = _elliptic(m)
    integral = 2 * a / (3 * np.pi * m) * ((1 + m) * second - (1 - m) * first)
    return 4 * np.pi * (1 - nu**2) / E * a * b * integral


def work_same(a: SX, E: SX, nu: SX) -> SX:
    """``work`` for a = b: 16 (1-nu^2) a^3 / (3 E)."""
    return 16 * (1 - nu**2) * a**3 / (3 * E)


def layer_correction(radii: list[SX], depth: SX, E: SX, nu: SX, nodes: int) -> SX:
    """What a bonded floor at ``depth`` changes in ``work`` between all pairs of discs; m^5/N, negative.

    Eq. (H2): 4 pi (1-nu^2)/E a b depth Int J1(xa/depth) J1(xb/depth) (L(x) - 1) / x^2 dx with
    L = (2 m sinh 2x - 4x) / (2 m cosh 2x + 1 + m^2 + 4x^2), m = 3 - 4 nu. With 24 nodes the
    integral is good to 1e-8 for radii up to 1.2 depths, with 48 to 1e-11 up to 4.
    """
    x, weight = np.polynomial.legendre.leggauss(nodes)
    x, weight = 10 * (x + 1), 10 * weight  # 1 - L falls like x^2 exp(-2x): nothing is left at 20
    row = ca.horzcat(*radii)
    total = ca.SX.zeros(len(radii), len(radii))
    for xi, wi in zip(x, weight, strict=True):
        wave = row * _bessel_j1(float(xi) * row / depth, nodes)
        total += float(wi / xi**2) * _floor(float(xi), nu) * ca.mtimes(wave.T, wave)
    return 4 * np.pi * (1 - nu**2) / E * depth * total


def strain(radii: list[SX], r: SX, z: SX, E: SX, nu: SX) -> tuple[SX, SX, SX, SX]:
    """Strains (rr, hoop, zz, rz) at radius r > 0 and depth z > 0 under unit pressure on each disc; rows, 1/Pa.

    Eq. (H3): Hankel integrals of Boussinesq's solution, turned by the addition theorem into means
    over the disc's edge: with R^2 = z^2 + a^2 + r^2 - 2 a r cos(phi) and <> the mean over phi,

        A  = a Int e^-kz J1(ka) J0(kr) dk          = <(a^2 - a r cos) / rho^2 (1 - z/R)>
        zA'= a z Int k e^-kz J1(ka) J0(kr) dk      = z <(a^2 - a r cos) / R^3>
        B  = a Int e^-kz J1(ka) J1(kr) / (kr) dk   = -(a/r) <cos ln(z + R)>
        zB'= a z Int e^-kz J1(ka) J1(kr) / r dk    = (a z / r) <cos / R>
        zC = a z Int k e^-kz J1(ka) J1(kr) dk      = a z^2 <cos / R^3>
    """
    phi = (np.arange(ANGLES) + 0.5) * np.pi / ANGLES
    a, c = ca.repmat(ca.horzcat(*radii), ANGLES, 1), ca.repmat(ca.DM(np.cos(phi)), 1, len(radii))
    R = ca.sqrt(z**2 + a**2 + r**2 - 2 * a * r * c)
    edge = a**2 - a * r * c
    A = _mean(edge / (R * (R + z)))  # (1 - z/R) / rho^2 without the cancellation
    zA = z * _mean(edge / R**3)
    B, zB = -_mean(a * c * ca.log(z + R)) / r, z * _mean(a * c / R) / r
    zC = z**2 * _mean(a * c / R**3)
    scale = -(1 + nu) / E
    lateral = (1 - 2 * nu) * A - zA  # rr + hoop
    hoop = (1 - 2 * nu) * B - zB
    return scale * (lateral - hoop), scale * hoop, scale * ((1 - 2 * nu) * A + zA), scale * zC


def _mean(rows: SX) -> SX:
    return ca.sum1(rows) / ANGLES


def _elliptic(m: SX) -> tuple[SX, SX]:
    """Complete elliptic integrals K(m), E(m), 0 < m < 1, by the arithmetic-geometric mean (DLMF 19.8.5-6)."""
    a, g, c2 = 1.0, ca.sqrt(1 - m), m
    total, power = c2 / 2, 0.5
    for _ in range(AGM_STEPS):
        a, g, c2 = (a + g) / 2, ca.sqrt(a * g), ((a - g) / 2) ** 2
        power *= 2
        total += power * c2
    first = np.pi / (2 * a)
    return first, first * (1 - total)


def _floor(x: float, nu: SX) -> SX:
    """L(x) - 1 of eq. (H2), without overflow: numerator and denominator times exp(-2x)."""
    m, fade = 3 - 4 * nu, float(np.exp(-2 * x))
    below = m * (1 + fade**2) + (1 + m**2 + 4 * x**2) * fade
    return (m * (1 - fade**2) - 4 * x * fade) / below - 1


def _bessel_j1(x: SX, points: int) -> SX:
    """J1 of a row, by the midpoint rule on Bessel's integral: exact to rounding for x < 0.6 ``points``, to 1e-8 for 1.2."""
    s = ca.DM(np.sin((np.arange(points) + 0.5) * np.pi / points))
    return ca.sum1(ca.sin(ca.mtimes(s, x)) * ca.repmat(s, 1, x.shape[1])) / points
