"""Works of the loads on each other on layered tissue.

The surface's compliance for waves k is C(k) / k, eq. LY.2. Its closed part is a half-space and a bed of springs that meet C at
the shortest waves K which are summed, C = A + B k there,

    2 pi [works on the half-space A + B Int t_i t_j r dr + Int_0^K (C - A - B k) t_i(k) t_j(k) dk]      (CF.20)

with ``half_space`` for the first, and B for pressures and shears alone. Where K passes the first layer's waves, A is that layer
and B nothing; above a thinner one A is what carries it, and B its own softness: what is left out beyond K fades with K's square.
The bottom that the stiffest layer would have on its own is taken as in tissue of one material, and out of the integral: layers
of one material are that material to rounding.

Under the disc of ``off_axis`` the c of eq. CF.18 is that of each pressure j_l alone, with C on half-spaces,

    c_l = A + 2 a (2l+1) / pi  Int_0^K (C - A) j_l(ka)^2 dk,     A of the first layer                (CF.22)

for pressure, and with the mean of C for shear along the wave and about the vertical for shear.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce

import numpy as np

from solver.closed_form.bessel import Array, compute_spherical_bessel
from solver.closed_form.half_space import compute_disc_works
from solver.closed_form.off_axis import MAX_DEGREE
from solver.closed_form.tractions import (
    BlockPair,
    build_wave_rule,
    combine_disc_works,
    integrate_load_products,
    list_disc_radii,
    transform_all_waves,
)
from solver.layers.stack import (
    LAYER_WAVE_REACH,
    PROBE_WAVE_REACH,
    TissueLayer,
    compute_compliance_change,
    compute_echoes,
    compute_floor_change,
    compute_last_wave,
    compute_shear_compliance,
)

NODES_PER_WAVE = 0.5  # times wave number and the outermost radius, beyond eight; at 0.35 squeezed layers had ratios off by 45 %
SLOPE_WAVE_RATIO = 0.9  # wave number, relative to the last, of the second point for the derivative B


def compute_layered_works(
    blocks: BlockPair, layers: tuple[TissueLayer, ...], depth: Array | None, nodes: int, bonded: bool
) -> list[Array]:
    """Compute the works of loads on each other: of pressures, shears and pressures on shears, (n, i, j) each, by eq. CF.20.

    The effect of a bottom below the stiffest layer alone is left out: ``contact`` adds it.

    Parameters
    ----------
    blocks
        Inner and outer.
    layers
        Of the tissue from the surface downwards, the last as thick as what is left above the bottom.
    depth
        Of the bottom, shape (n,); None on half-spaces.
    nodes
        Of the integral over wave numbers.
    bonded
        Whether there are shears.
    """
    K = _choose_last_wave(blocks[1].radius, layers[0], nodes)
    fractions, weight = build_wave_rule(nodes)
    waves = K * fractions
    C = _compute_surface_compliance(np.concatenate([waves, K, K * SLOPE_WAVE_RATIO], axis=1), layers, depth)
    half_space, springs = _fit_short_waves(
        C, K, layers[0], is_cut=(K[:, 0] * layers[0].thickness).real < 0.999 * LAYER_WAVE_REACH
    )
    remainders = [K * weight * (part[:, :-2] - a - b * waves) for part, a, b in zip(C, half_space, springs, strict=True)]
    ones = np.ones(len(K), dtype=K.dtype)
    closed = combine_disc_works(
        blocks, compute_disc_works(*list_disc_radii(blocks), ones, 0 * ones)
    )  # w = p / k, u = q / k, w = -q / 2k
    works = [a[:, :, None] * work for a, work in zip((*half_space[:2], -2 * half_space[2]), closed, strict=True)]
    p, q = transform_all_waves(blocks, waves, bonded)
    for work, part, left, right in zip(works, remainders, (p, q, p)[: 3 if bonded else 1], (p, q, q), strict=False):
        work += 2 * np.pi * _sum_waves(left, part, right)
    for work, derivative, products in zip(works, springs, integrate_load_products(blocks), strict=False):
        work += derivative[:, :, None] * products
    return works


def _fit_short_waves(C: Sequence[Array], K: Array, first: TissueLayer, is_cut: Array) -> tuple[list[Array], list[Array]]:
    """Return A and B of eq. CF.20, shapes (n, 1), from C at waves of which the last two are K and ``SLOPE_WAVE_RATIO`` K.

    Parameters
    ----------
    C
        Compliance under pressures, shears and both, shape (n, waves) each.
    K
        The last wave number, shape (n, 1).
    first
        The first layer.
    is_cut
        Whether K is so small that waves which pass the first layer are left out, shape (n,). Otherwise A is the first layer's own
        compliance, and B is 0.
    """
    half_space, springs = [], []
    for part, top, bed in zip(C, first.half_space, (True, True, False), strict=True):
        last_value, previous_value = part[:, -2, None], part[:, -1, None]
        derivative = (last_value - previous_value) / ((1 - SLOPE_WAVE_RATIO) * K)
        derivative = np.where(is_cut[:, None] & bed & (derivative.real > 0), derivative, 0 * derivative)
        springs.append(derivative)
        half_space.append(np.where(is_cut[:, None], last_value - derivative * K, top / (2 * first.mu)))
    return half_space, springs


def _choose_last_wave(radius: Array, first: TissueLayer, nodes: int) -> Array:
    """Return K of eq. CF.20, 1/m, shape (n, 1), limited to what the nodes resolve: they may have been counted for another design.

    ``radius`` is the probe's, ``first`` the first layer.
    """
    K, resolved = compute_last_wave(radius, first.thickness), (nodes - 8) / (NODES_PER_WAVE * radius)
    return np.where(K.real < resolved.real, K, resolved)[:, None]


def count_layer_nodes(radius: float, thickness: float) -> int:
    """Return how many nodes, a multiple of 4, the integral of eq. CF.20 needs.

    ``radius`` is the probe's outer radius, ``thickness`` that of the first layer, m.
    """
    reach = min(LAYER_WAVE_REACH / thickness * radius, PROBE_WAVE_REACH)
    return 4 * math.ceil((8 + NODES_PER_WAVE * reach) / 4)


def find_stiffest(layers: tuple[TissueLayer, ...]) -> TissueLayer:
    """Return the stiffest of the layers for each design, without a thickness."""

    def choose_stiffer(upper: TissueLayer, lower: TissueLayer) -> TissueLayer:
        """Return the stiffer of two layers for each design."""
        first = upper.E.real >= lower.E.real
        return TissueLayer(None, np.where(first, upper.E, lower.E), np.where(first, upper.nu, lower.nu))

    return reduce(choose_stiffer, layers)


def compute_disc_compliances(radius: Array, layers: tuple[TissueLayer, ...], nodes: int) -> tuple[Array, Array]:
    """Return c_l of eq. CF.22 under pressure and under shear, shapes (n, DEGREE + 1).

    Parameters
    ----------
    radius
        a, shape (n,).
    layers
        Of the tissue, the last a half-space.
    nodes
        Of the integral over wave numbers.
    """
    K = _choose_last_wave(radius, layers[0], nodes)
    fractions, weight = build_wave_rule(nodes)
    k, first = K * fractions, layers[0]
    near_echo = compute_echoes(k, layers, False)[0].near_echo
    assert near_echo is not None
    pressed, sheared, _ = (part / (2 * first.mu) for part in compute_compliance_change(first, near_echo))
    turned = compute_shear_compliance(k, layers) - 1 / first.mu
    normal = first.half_space[0] / (2 * first.mu)
    squares = compute_spherical_bessel(k * radius[:, None], MAX_DEGREE + 1) ** 2 * (K * weight)
    degree_factors = 2 * radius[:, None] * (2 * np.arange(MAX_DEGREE + 1) + 1) / np.pi
    return (
        normal + degree_factors * (squares * pressed).sum(axis=2).T,
        (normal + 1 / first.mu) / 2 + degree_factors * (squares * (sheared + turned) / 2).sum(axis=2).T,
    )


def _compute_surface_compliance(k: Array, layers: tuple[TissueLayer, ...], depth: Array | None) -> list[Array]:
    """Return C of eq. CF.20 for pressures, shears and both, shapes (n, q), for waves k (n, q).

    What a bottom at ``depth`` would add below the stiffest layer alone is subtracted; ``depth`` is None on half-spaces.
    """
    first, near_echo = layers[0], compute_echoes(k, layers, depth is not None)[0].near_echo
    change = (0.0, 0.0, 0.0) if near_echo is None else compute_compliance_change(first, near_echo)
    compliances = [(a + b) / (2 * first.mu) for a, b in zip(first.half_space, change, strict=True)]
    if depth is None:
        return [part + 0 * k for part in compliances]
    stiffest = find_stiffest(layers)
    floor_layer = TissueLayer(depth, stiffest.E, stiffest.nu)
    floor = compute_floor_change(k, floor_layer)
    return [part - floor_part / (2 * floor_layer.mu) for part, floor_part in zip(compliances, floor, strict=True)]


def _sum_waves(left: Array, weights: Array, right: Array) -> Array:
    """Return sums over waves of weights (n, q) times products of transforms (n, q, i) and (n, q, j), shape (n, i, j)."""
    return left.swapaxes(1, 2) @ (weights[:, :, None] * right)
