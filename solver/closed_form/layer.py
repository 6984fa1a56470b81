"""Waves in one layer of tissue: displacements and strains at a depth.

Loads and displacements are Hankel integrals. For one wave number k, depth z below the layer's top, t = k z and m = 3 - 4 nu the
displacements u = U J1(kr), w = W J0(kr) (w downwards) are sums of four solutions of Navier's equation,

    U = (c1 + c2 t) e^-t + (c3 - c4 t) e^(t-2x),   W = (c1 + c2 (t+m)) e^-t + (-c3 + c4 (t-m)) e^(t-2x)      (CF.6)

with x = k h and h the layer's thickness. Downward waves of tractions a = (p, q), eq. LY.1, have

    c1 = [2 (1-nu) q - (1-2nu) p] / (2 mu k),     c2 = (p - q) / (2 mu k)                                    (CF.7)

and their echo from below, r F a = (p', q') times e^-x at the layer's bottom with r and F of eqs. LY.1 and LY.2, has
c4 = (p' + q') / (2 mu k) and c3 = x c4 - [2 (1-nu) q' + (1-2nu) p'] / (2 mu k).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver.closed_form.bessel import Array
from solver.layers.stack import Echo, TissueLayer, compute_arriving, compute_echoes

WavePair = tuple[Array, Array]


@dataclass(frozen=True)
class Waves:
    """Coefficients of eq. CF.6 times 2 mu for waves k under unit pressure and under unit shear: at the surface, or downwards.

    Attributes
    ----------
    k
        Wave numbers, 1/m, shape (n, q).
    depth
        Thickness h of the layer, m, shape (n, 1); None for a half-space.
    nu
        Shape (n, 1).
    by_pressure, by_shear
        (c1, c2, c3, c4), each of shape (n, q); the last two None on a half-space.
    """

    k: Array
    depth: Array | None
    nu: Array
    by_pressure: tuple[Array, ...]
    by_shear: tuple[Array, ...]


def solve_waves(k: Array, depth: Array, nu: Array) -> Waves:
    """Return the waves k (n, q) under unit loads at the surface of single layers on a rigid bottom.

    ``depth`` are the layers' thicknesses and ``nu`` their Poisson's ratios, shape (n,).
    """
    layer = TissueLayer(depth, np.ones_like(depth), nu)  # waves times 2 mu do not depend on the modulus
    echoes = compute_echoes(k, [layer], True)
    waves = build_waves_in_layer(k, layer, echoes[0])
    pp, pq, qp, qq = compute_arriving(echoes, 0)
    pairs = list(zip(waves.by_pressure, waves.by_shear, strict=True))
    by_pressure, by_shear = tuple(pp * p + qp * q for p, q in pairs), tuple(pq * p + qq * q for p, q in pairs)
    return Waves(k, waves.depth, waves.nu, by_pressure, by_shear)


def compute_fields(waves: Waves, z: Array, *, mirrored: bool = False) -> list[tuple[Array, ...]]:
    """Return k U, b + b', (dU/dz - k W)/2 and k W at depths z, under unit pressure and under unit shear, times 2 mu.

    U and W are the amplitudes of eq. CF.6. With a = (c1 + c2 t) e^-t, b = c2 e^-t and a' = (c3 - c4 t) e^(t-2x), b' = c4 e^(t-2x)
    they are k times a + a', b + b', (2nu-1) (b - b') - a + a' and (3-4nu) (b - b') + a - a'; dW/dz is 2 (2nu-1) (b + b') minus k
    U.

    Parameters
    ----------
    waves
        Coefficients of q waves for each of n designs.
    z
        Depths, shape (n, p).
    mirrored
        Whether the depths are their own mirror image in the layer's middle, so that the same exponentials serve waves of both
        directions.

    Returns
    -------
    list[tuple[Array, ...]]
        Four arrays of shape (p, q, n) by pressure, and by shear: designs last, where waves and depths are broadcast fast.
    """
    k, nu = waves.k.T.copy(), waves.nu[:, 0]
    t = k * z.T[:, None]
    fade = np.exp(-t)
    downward, upward = (fade, t * fade), None
    if waves.depth is not None:
        x = k * waves.depth[:, 0]
        rising_fade = np.exp(-x) * fade[::-1] if mirrored else np.exp(t - 2 * x)
        upward = rising_fade, t * rising_fade
    results = []
    for load in (waves.by_pressure, waves.by_shear):
        plain, b_sum, b_difference, mirrored_plain = _combine_waves([k * part.T for part in load], downward, upward)
        results.append((plain, b_sum, (2 * nu - 1) * b_difference - mirrored_plain, (3 - 4 * nu) * b_difference + mirrored_plain))
    return results


def compute_strain_amplitudes(
    load: Sequence[Array], downward: WavePair, upward: WavePair | None, two_nu_minus_1: Array
) -> tuple[Array, Array, Array]:
    """Return k U, dW/dz and (dU/dz - k W)/2 of eq. CF.6, with averages of the exponentials in place of the exponentials.

    Parameters
    ----------
    load
        The coefficients c1 to c4 of eq. CF.6, or c1 and c2 on a half-space, times k.
    downward
        (averages of) e^-t and t e^-t.
    upward
        (averages of) e^(t-2x) and t e^(t-2x); None on a half-space.
    two_nu_minus_1
        2 nu - 1; all arrays broadcast.
    """
    plain, b_sum, b_difference, mirrored_plain = _combine_waves(load, downward, upward)
    return plain, 2 * two_nu_minus_1 * b_sum - plain, two_nu_minus_1 * b_difference - mirrored_plain


def _combine_waves(load: Sequence[Array], downward: WavePair, upward: WavePair | None) -> tuple[Array, Array, Array, Array]:
    """Return a + a', b + b', b - b' and a - a' of ``compute_fields``; see ``compute_strain_amplitudes`` for the arguments."""
    # a' and b' belong to upward waves, which a half-space does not have
    a, b = load[0] * downward[0] + load[1] * downward[1], load[1] * downward[0]
    if upward is None:
        return a, b, b, a
    upward_a, upward_b = load[2] * upward[0] - load[3] * upward[1], load[3] * upward[0]
    return a + upward_a, b + upward_b, b - upward_b, a - upward_a


def build_waves_in_layer(k: Array, layer: TissueLayer, echo: Echo) -> Waves:
    """Build the waves k (n, q) of eq. CF.6 in a layer among others, z from its top, under unit downward waves a (eq. LY.1) there.

    ``by_pressure`` is the field of a = (1, 0) with its echo from below, ``by_shear`` that of a = (0, 1).
    """
    nu = layer.nu[:, None]
    shear_factor, pressure_factor = 1 - 2 * nu, 2 - 2 * nu
    downward = ((-shear_factor / k, 1 / k), (pressure_factor / k, -1 / k))
    if echo.far_echo is None:
        return Waves(k, None, nu, *downward)
    r, x = echo.far_echo, echo.path
    columns = []
    # (p, q): columns of F, without its e^-x; (bp, bq): the echo (p', q') of eq. CF.7 at the layer's bottom
    for (c1, c2), (p, q) in zip(downward, ((1 + x, x), (-x, 1 - x)), strict=True):
        bp, bq = r[0] * p + r[2] * q, r[2] * p + r[1] * q
        c4 = (bq + bp) / k
        columns.append((c1, c2, -(pressure_factor * bq + shear_factor * bp) / k + x * c4, c4))
    return Waves(k, layer.thickness[:, None], nu, *columns)
