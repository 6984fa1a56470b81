"""Pressures and shears under a block: a few smooth functions and the singularities of its edges, as sums of rings.

Every function is a value on each of several rings, narrow at the edges; y is the fraction of the width (0 at the axis or hole).
With pressures 1, y^2 and (1-y^2)^(-1/2) under a disc, 1, y, y^(-1/2) and (1-y)^(-1/2) under a tube, and shears r times such, two
blocks of any stiffness need eleven unknowns. Rings are differences of discs, which closed formulas know; in integrals over long
waves a load is its values at few radii, exact for polynomials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from geometry.common.arrays import Floats, Ints
from solver.closed_form.bessel import Array, bessel


@dataclass(frozen=True)
class ElasticBlocks:
    """n blocks, all solid (``hole`` None) or all tubes; arrays of shape (n,), SI.

    Attributes
    ----------
    hole, radius, height
        Inner radius, outer radius and height, m.
    E, nu
        Young's modulus, Pa, and Poisson's ratio.
    """

    hole: Array | None
    radius: Array
    height: Array
    E: Array
    nu: Array

    def take(self, which: Ints) -> ElasticBlocks:
        """Return the blocks with indices ``which``."""
        hole = None if self.hole is None else self.hole[which]
        return ElasticBlocks(hole, self.radius[which], self.height[which], self.E[which], self.nu[which])

    @property
    def start(self) -> Array:
        """Inner radius, m."""
        return 0 * self.radius if self.hole is None else self.hole

    @property
    def width(self) -> Array:
        """Radius of a disc, wall of a tube, m."""
        return self.radius - self.start

    @property
    def area(self) -> Array:
        """Area of the end, m^2."""
        return np.pi * self.width * (self.radius + self.start)

    @property
    def steepness(self) -> Array:
        """The decay b of eq. CF.9 times the height."""
        # b times the width is one number for all discs, another for all tubes
        return (2.2 if self.hole is None else 2.0) * self.height / self.width

    def radii(self, y: Floats) -> Array:
        """Return the radii at fractions y (k,) of the width, m, shape (n, k)."""
        return self.start[:, None] + self.width[:, None] * np.asarray(y)


BlockPair = tuple[ElasticBlocks, ElasticBlocks]  # the inner block and the outer


@dataclass(frozen=True)
class Loads:
    """The functions under one kind of block, the same for all of that kind.

    Attributes
    ----------
    cuts
        Fractions of the width where rings meet, shape (rings + 1,).
    pressure, shear
        Values on the rings, shapes (rings, functions).
    solid
        Whether the block is a disc.
    """

    cuts: Any
    pressure: Any
    shear: Any
    solid: bool

    @cached_property
    def radii(self) -> Any:
        """Fractions of the width at which the loads are concentrated for the integrals over wave numbers.

        Waves are even functions of the radius: under a disc the radii are Gauss's in its square.
        """
        x = (legendre.leggauss(RADII)[0] + 1) / 2
        return np.sqrt(x) if self.solid else x

    def build_transform(self, values: Any) -> Any:
        """Build the matrix that gives the integrals of a wave times each function from the wave's values at ``radii``.

        It has the shape (radii, functions). ``values`` are the functions' values on the rings, (rings, functions). The rule is
        exact for waves that are polynomials: of y^2 under a disc, of y under a tube. Integrals are over the width times r; the
        factor r is applied to the wave's values by the caller, so that a disc's weights are divided by it.
        """
        polynomials = [legendre.Legendre(row, domain=[0, 1]) for row in np.eye(RADII)]
        x, cuts = (self.radii**2, self.cuts**2) if self.solid else (self.radii, self.cuts)
        moments = np.array([np.diff(p.integ()(cuts)) for p in polynomials])
        weights = np.linalg.solve(np.array([p(x) for p in polynomials]), moments) @ values
        return weights / (2 * self.radii[:, None]) if self.solid else weights


def multiply_batches(matrices: Any, matrix: Floats) -> Any:
    """Multiply matrices (n, i, j) by one matrix (j, k) as a single product, which is faster than n products."""
    return (matrices.reshape(-1, len(matrix)) @ matrix).reshape(*matrices.shape[:-1], -1)


def _average_on_rings(cuts: Any, function: Any) -> Any:
    """Return the means of a function of y over the rings between ``cuts``, shape (rings,).

    With y = (1 - cos(turn)) / 2 the rule is accurate for inverse square roots at both ends of (0, 1).
    """
    angle, weight = legendre.leggauss(8)
    low, high = (np.arccos(1 - 2 * c)[:, None] for c in (cuts[:-1], cuts[1:]))
    turn = (low + high) / 2 + (high - low) / 2 * angle
    y, jacobian = (1 - np.cos(turn)) / 2, np.sin(turn) / 2 * (high - low) / 2
    return (function(y) * jacobian) @ weight / ((jacobian) @ weight)


RINGS, RADII = 6, 4  # rings under a block, and radii at which loads act in the integrals over wave numbers
_DISC_PRESSURES = (lambda y: 1 + 0 * y, lambda y: (1 - y**2) ** -0.5, lambda y: y**2)
_TUBE_PRESSURES = (lambda y: y**-0.5, lambda y: (1 - y) ** -0.5, lambda y: 1 + 0 * y, lambda y: y)
SHEARS = 2  # the first of the pressures are those of the shears, times r


@dataclass(frozen=True)
class PairLoads:
    """The functions under both blocks.

    Attributes
    ----------
    loads
        The functions under the disc and under the tube.
    discs
        Pressures, and shears, as sums of uniform loads on discs: factors of the discs, shapes (discs, functions).
    transform_weights
        Their transforms as sums over the radii at which loads are concentrated: weights, shapes (radii, functions).
    """

    loads: tuple[Loads, Loads]
    discs: tuple[Any, Any]
    transform_weights: tuple[Any, Any]


def _build_pair_loads() -> PairLoads:
    """Build the loads of both blocks, their rings narrow at the edges."""
    # cuts are dense at the outer edge of a disc, and at both edges of a tube
    step = np.arange(RINGS + 1) / RINGS
    cuts = 1 - (1 - step) ** 3, step**3 / (step**3 + (1 - step) ** 3)
    pressures = [
        np.array([_average_on_rings(block_cuts, function) for function in functions]).T
        for block_cuts, functions in zip(cuts, (_DISC_PRESSURES, _TUBE_PRESSURES), strict=True)
    ]
    disc, tube = (
        Loads(block_cuts, pressure, pressure[:, :SHEARS], solid)
        for block_cuts, pressure, solid in zip(cuts, pressures, (True, False), strict=True)
    )
    disc_rings = np.eye(RINGS) - np.eye(RINGS, k=1)  # differences of discs
    # a tube's rings are discs of the outer less discs of the inner radius
    tube_rings = np.eye(RINGS + 1, RINGS, k=-1) - np.eye(RINGS + 1, RINGS)
    kinds = (disc.pressure, tube.pressure), (disc.shear, tube.shear)
    discs = [_join_blocks(disc_rings @ on_disc, tube_rings @ on_tube) for on_disc, on_tube in kinds]
    weights = [_join_blocks(disc.build_transform(on_disc), tube.build_transform(on_tube)) for on_disc, on_tube in kinds]
    return PairLoads((disc, tube), (discs[0], discs[1]), (weights[0], weights[1]))


def _join_blocks(disc: Floats, tube: Floats) -> Floats:
    """Return one block-diagonal matrix of a disc's and a tube's matrix."""
    return np.asarray(build_block_diagonal((disc[None], tube[None]))[0])


def compute_load_areas(blocks: BlockPair, like: Array) -> Array:
    """Return A of eq. CF.12, the force of each unit load on each block, m^2, shape (n, loads, 2); shears have none.

    ``like`` is an array (n, loads, ...) of the same type.
    """
    areas = np.zeros((len(like), like.shape[1], 2), dtype=like.dtype)
    row = 0
    for i, (block, loads) in enumerate(zip(blocks, LOADS.loads, strict=True)):
        r = block.radii(loads.cuts)
        rings = np.pi * block.width[:, None] * np.diff(loads.cuts) * (r[:, 1:] + r[:, :-1])
        areas[:, row : row + loads.pressure.shape[1], i] = rings @ loads.pressure
        row += loads.pressure.shape[1]
    return areas


def join_works(works: Sequence[Array]) -> Array:
    """Join the works of pressures, shears and pressures on shears, (n, i, j) each, to symmetric matrices (n, loads, loads)."""
    pressure, shear, cross = works
    top_rows = np.concatenate([pressure, cross], axis=2)
    return np.concatenate([top_rows, np.concatenate([cross.swapaxes(1, 2), shear], axis=2)], axis=1)


def build_block_diagonal(parts: tuple[Array, Array]) -> Array:
    """Build block-diagonal matrices from two arrays of matrices (n, i, j)."""
    first, second = parts
    n, a, b = first.shape
    full = np.zeros((n, a + second.shape[1], b + second.shape[2]), dtype=first.dtype)
    full[:, :a, :b], full[:, a:, b:] = first, second
    return full


def list_disc_radii(blocks: BlockPair) -> tuple[Array, Array]:
    """Return the radii of the discs whose differences are the rings, and the outer radius of each disc's block, m, (n, discs)."""
    inner, outer = (block.radii(loads.cuts) for block, loads in zip(blocks, LOADS.loads, strict=True))
    count = inner.shape[1] - 1  # the inner block's disc of radius 0 is left out
    radius = np.stack([block.radius for block in blocks], axis=1)[:, [0] * count + [1] * (count + 2 - 1)]
    return np.concatenate([inner[:, 1:], outer], axis=1), radius


def combine_disc_works(blocks: BlockPair, works: Sequence[Array]) -> list[Array]:
    """Combine the works of discs, (n, discs, discs), to works of the loads, both of pressures, shears and pressures on shears."""
    pressure, shear = LOADS.discs
    sides = ((pressure, pressure), (shear, shear), (pressure, shear))
    return [_combine_works(work, left, right) for work, (left, right) in zip(works, sides, strict=True)]


def _combine_works(work: Array, left: Floats, right: Floats) -> Array:
    """Return left^T work right, shape (n, loads, loads), for matrices ``work`` (n, i, j) whose axis n is last in memory."""
    rows = work.transpose(1, 2, 0)
    halves = (left.T @ rows.reshape(len(left), -1)).reshape(-1, *rows.shape[1:])
    return (right.T @ halves).transpose(2, 0, 1).copy()


@lru_cache(maxsize=64)
def build_wave_rule(nodes: int, powers: tuple[float, float, float] = (0.2, 0.8, 0.0)) -> tuple[Any, Any]:
    """Return wave numbers as fractions of their maximum, denser among long waves, and their weights, shapes (nodes,).

    The fractions are a cubic of the nodes s of Gauss's rule on (0, 1); ``powers`` are its coefficients of s, s^2 and s^3.
    """
    s, weight = legendre.leggauss(nodes)
    s = (s + 1) / 2
    linear, quadratic, cubic = powers
    return s * (linear + s * (quadratic + s * cubic)), (linear + s * (2 * quadratic + s * 3 * cubic)) * weight / 2


def transform_long_waves(blocks: BlockPair, k: Array, bonded: bool) -> tuple[Array, Array]:
    """Return Hankel transforms of pressures and shears (no shears unless bonded) at long waves k (n, q); shapes (n, q, loads)."""
    pair = LOADS
    radii = np.concatenate([block.radii(loads.radii) for block, loads in zip(blocks, pair.loads, strict=True)], axis=1)
    points = radii.shape[1] // 2
    J0, J1 = bessel(k[:, :, None] * radii[:, None, :])
    outer = np.repeat(np.stack([block.radius for block in blocks], axis=1), points, axis=1)
    rings = radii * np.repeat(np.stack([block.width for block in blocks], axis=1), points, axis=1)
    pressure = multiply_batches(J0 * rings[:, None, :], pair.transform_weights[0])
    if not bonded:
        return pressure, pressure[:, :, :0]
    return pressure, multiply_batches(J1 * (rings * radii / outer)[:, None, :], pair.transform_weights[1])


def transform_all_waves(blocks: BlockPair, k: Array, bonded: bool) -> tuple[Array, Array]:
    """Return Hankel transforms of pressures and shears (no shears unless bonded) at waves k (n, q) of any length.

    They are those of the rings themselves, from the transforms a J1(ka)/k and a^2 J2(ka)/k of discs; shapes (n, q, loads).
    """
    (c, radius), discs = list_disc_radii(blocks), LOADS.discs
    kinds = bessel(k[:, :, None] * c[:, None, :], 3 if bonded else 2, first=1)
    pressure = multiply_batches(kinds[0] * c[:, None, :] / k[:, :, None], discs[0])
    if not bonded:
        return pressure, pressure[:, :, :0]
    return pressure, multiply_batches(kinds[1] * (c * c / radius)[:, None, :] / k[:, :, None], discs[1])


def integrate_load_products(blocks: BlockPair) -> tuple[Array, Array]:
    """Integrate products of two pressures, and of two shears, over the ends: p and s functions, (n, p, p) and (n, s, s), m^2."""
    pressures: list[Array] = []
    shears: list[Array] = []
    for block, loads in zip(blocks, LOADS.loads, strict=True):
        squared_radii = block.radii(loads.cuts) ** 2
        discs = np.pi * squared_radii, np.pi / 2 * (squared_radii / block.radius[:, None]) ** 2
        for products, disc, values in zip((pressures, shears), discs, (loads.pressure, loads.shear), strict=True):
            products.append(values.T @ (np.diff(disc, axis=1)[:, :, None] * values))
    return build_block_diagonal((pressures[0], pressures[1])), build_block_diagonal((shears[0], shears[1]))


LOADS = _build_pair_loads()
