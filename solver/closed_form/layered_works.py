"""Works of the loads on each other on layered tissue.

The surface's compliance for waves k is C(k) / k, eq. LY.2. Its closed part is a half-space and a bed of springs that meet C at
the shortest waves K which are summed, C = A + B k there,

    2 pi [works on the half-space A + B Int t_i t_j r dr + Int_0^K (C - A - B k) t_i(k) t_j(k) dk]      (CF.20)

with ``half_space`` for the first, and B for pressures and shears alone. Where K passes the first layer's waves, A is that layer
and B nothing; above a thinner one A is what carries it, and B its own softness: what is left out beyond K fades with K's square.
The floor that the stiffest layer would have on its own is taken as in tissue of one material, and out of the integral: layers
of one material are that material to rounding.

Under the disc of ``off_axis`` the c of eq. CF.18 is that of each pressure j_l alone, with C on half-spaces,

    c_l = A + 2 a (2l+1) / pi  Int_0^K (C - A) j_l(ka)^2 dk,     A of the first layer                (CF.22)

for pressure, and with the mean of C for shear along the wave and about the vertical for shear.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce
from typing import TYPE_CHECKING

import numpy as np

from solver.closed_form.bessel import Array, spherical
from solver.closed_form.half_space import ring_work
from solver.closed_form.off_axis import DEGREE
from solver.closed_form.tractions import all_waves, between_waves, circles, of_rings, own_products
from solver.layers.stack import PASSING, SHORTEST, Symmetric, TissueLayer, change, echoes, shortest
from solver.layers.vertical_shear import shear_surface

if TYPE_CHECKING:
    from solver.closed_form.tractions import Pair

NODES_PER_WAVE = 0.35  # times wave number and the outermost radius, beyond eight
NEAR = 0.9  # wave number, relative to the last, of the second point for the derivative B


def layered_works(blocks: Pair, layers: tuple[TissueLayer, ...], depth: Array | None, nodes: int, bonded: bool) -> list[Array]:
    """Compute the works of pressures, shears and pressures on shears, without the floor of the stiffest layer alone.

    Args:
        blocks: inner and outer.
        layers: of the tissue from the surface downwards, the last as thick as what is left above the floor.
        depth: of the floor, shape (n,); None on half-spaces.
        nodes: of the integral over wave numbers.
        bonded: whether there are shears.
    """
    K = _last_wave(blocks[1].radius, layers[0], nodes)
    share, weight = between_waves(nodes)
    waves = K * share
    C = _surface(np.concatenate([waves, K, K * NEAR], axis=1), layers, depth)
    firm, springs = _short_waves(C, K, layers[0], cut=(K[:, 0] * layers[0].thickness).real < 0.999 * PASSING)
    rest = [K * weight * (part[:, :-2] - a - b * waves) for part, a, b in zip(C, firm, springs, strict=True)]
    one = np.ones(len(K), dtype=K.dtype)
    closed = of_rings(blocks, ring_work(*circles(blocks), one, 0 * one))  # w = p / k, u = q / k, w = -q / 2k
    works = [a[:, :, None] * work for a, work in zip((*firm[:2], -2 * firm[2]), closed, strict=True)]
    p, q = all_waves(blocks, waves, bonded)
    for work, part, left, right in zip(works, rest, (p, q, p)[: 3 if bonded else 1], (p, q, q), strict=False):
        work += 2 * np.pi * _summed(left, part, right)
    for work, slope, products in zip(works, springs, own_products(blocks), strict=False):
        work += slope[:, :, None] * products
    return works


def _short_waves(C: Sequence[Array], K: Array, first: TissueLayer, cut: Array) -> tuple[list[Array], list[Array]]:
    """Return A and B of eq. CF.20, shapes (n, 1), from C at waves of which the last two are K and ``SLOPE_WAVE_RATIO`` K.

    ``cut`` is true where K does not pass the first layer's waves, shape (n,).
    """
    firm, springs = [], []
    for part, top, bed in zip(C, first.half_space, (True, True, False), strict=True):
        at, before = part[:, -2, None], part[:, -1, None]
        slope = (at - before) / ((1 - NEAR) * K)
        slope = np.where(cut[:, None] & bed & (slope.real > 0), slope, 0 * slope)
        springs.append(slope)
        firm.append(np.where(cut[:, None], at - slope * K, top / (2 * first.mu)))
    return firm, springs


def _last_wave(radius: Array, first: TissueLayer, nodes: int) -> Array:
    """Return K of eq. CF.20, shape (n, 1), limited to what the nodes resolve: they may have been counted for another design."""
    K, resolved = shortest(radius, first.thickness), (nodes - 8) / (NODES_PER_WAVE * radius)
    return np.where(K.real < resolved.real, K, resolved)[:, None]


def layer_nodes(radius: float, thickness: float) -> int:
    """Return how many nodes the integral of eq. CF.20 needs."""
    reach = min(PASSING / thickness * radius, SHORTEST)
    return 4 * math.ceil((8 + NODES_PER_WAVE * reach) / 4)


def stiffest(layers: tuple[TissueLayer, ...]) -> TissueLayer:
    """Return the stiffest of the layers for each design, without a thickness."""

    def stiffer(one: TissueLayer, other: TissueLayer) -> TissueLayer:
        first = one.E.real >= other.E.real
        return TissueLayer(None, np.where(first, one.E, other.E), np.where(first, one.nu, other.nu))

    return reduce(stiffer, layers)


def disc_compliances(radius: Array, layers: tuple[TissueLayer, ...], nodes: int) -> tuple[Array, Array]:
    """Return c_l of eq. CF.22 under pressure and under shear, shapes (n, DEGREE + 1).

    Args:
        radius: a, shape (n,).
        layers: of the tissue, the last a half-space.
        nodes: of the integral over wave numbers.
    """
    K = _last_wave(radius, layers[0], nodes)
    share, weight = between_waves(nodes)
    k, first = K * share, layers[0]
    near = echoes(k, layers, False)[0].near
    assert near is not None
    pressed, sheared, _ = (part / (2 * first.mu) for part in change(first, near))
    turned = shear_surface(k, layers) - 1 / first.mu
    normal = first.half_space[0] / (2 * first.mu)
    squares = spherical(k * radius[:, None], DEGREE + 1) ** 2 * (K * weight)
    times = 2 * radius[:, None] * (2 * np.arange(DEGREE + 1) + 1) / np.pi
    return (
        normal + times * (squares * pressed).sum(axis=2).T,
        (normal + 1 / first.mu) / 2 + times * (squares * (sheared + turned) / 2).sum(axis=2).T,
    )


def _surface(k: Array, layers: tuple[TissueLayer, ...], depth: Array | None) -> list[Array]:
    """Return C of eq. CF.20 for pressures, shears and both, without the floor of the stiffest layer alone; shapes (n, q)."""
    first, near = layers[0], echoes(k, layers, depth is not None)[0].near
    whole = [(a + b) / (2 * first.mu) for a, b in zip(first.half_space, _echoed(first, near), strict=True)]
    if depth is None:
        return [part + 0 * k for part in whole]
    firm = stiffest(layers)
    alone = TissueLayer(depth, firm.E, firm.nu)
    floor = change(alone, _echo_of(k, alone))
    return [part - own / (2 * alone.mu) for part, own in zip(whole, floor, strict=True)]


def _echoed(first: TissueLayer, near: Symmetric | None) -> Symmetric:
    return (0.0, 0.0, 0.0) if near is None else change(first, near)


def _echo_of(k: Array, alone: TissueLayer) -> Symmetric:
    near = echoes(k, [alone], True)[0].near
    assert near is not None
    return near


def _summed(left: Array, weights: Array, right: Array) -> Array:
    return left.swapaxes(1, 2) @ (weights[:, :, None] * right)
