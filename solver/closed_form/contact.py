"""Two blocks on a layer with spheres: the tractions that move all ends together, for many designs at once.

Unknown are pressures p and, where bonded, shears q on rings under both blocks. With C the work of unit loads' displacements on
each other, of tissue and blocks' ends, and A_j the areas of the rings under block j,

    C t_j = A_j,   F_ij = A_i^T t_j                                                                 (CF.12)

for block j's base moved by one unit, to which the spheres add eq. CF.14 of ``inclusions``. On a half-space C is closed
(``half_space``); the floor and the spheres take integrals over wave numbers, in which a ring's load is its values at few
radii, exact for polynomials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from geometry.common.resources import check_time
from solver.closed_form.bessel import Array, bessel
from solver.closed_form.block_compliance import ElasticBlocks, end_compliance
from solver.closed_form.half_space import ring_work
from solver.closed_form.inclusions import polarised
from solver.closed_form.lateral_boundary import Sides, cut_waves, free_sides
from solver.closed_form.layer import Waves, floor_compliance, waves
from solver.closed_form.off_axis import Disc
from solver.closed_form.surface_images import SphereArray
from solver.closed_form.tractions import RADII, SOLID, TUBE, batched_matmul

REACH = 10.0  # exponents of what is left out of the integrals
FLOOR_REACH = 6.0
NODES_PER_WAVE = 0.35  # times wave number and the outermost radius, beyond eight


@dataclass(frozen=True)
class Tissue:
    """Layers bonded to a floor at ``depth`` (None: half-spaces): modulus, Poisson's ratio; arrays of shape (n,), SI.

    ``radius`` is that of the free sides, if they are near.
    """

    depth: Any
    E: Array
    nu: Array
    radius: Any = None

    @property
    def mu(self) -> Array:
        """Shear modulus."""
        return self.E / (2 * (1 + self.nu))


@dataclass(frozen=True)
class ContactSolution:
    """What designs answer.

    Attributes:
        forces: F_ij, N/m, shape (n, 2, 2).
        slope: their derivatives by ln of the target's modulus, zero without one.
        works, areas, tractions: C, A and t of eq. CF.12, shapes (n, loads, loads), (n, loads, 2) and (n, loads, 2).
    """

    forces: Array
    slope: Array
    works: Array
    areas: Array
    tractions: Array

    @property
    def residual(self) -> Array:
        """What is left of eq. CF.12, relative to the largest sum of its terms' sizes, shape (n,)."""
        unbalanced = np.abs(self.works @ self.tractions - self.areas)
        return unbalanced.max(axis=(1, 2)) / (np.abs(self.works) @ np.abs(self.tractions)).max(axis=(1, 2))


def solve_contact(
    blocks: tuple[ElasticBlocks, ElasticBlocks],
    tissue: Tissue,
    spheres: Sequence[SphereArray],
    *,
    target: int | None,
    bonded: bool,
    nodes: int,
    side_nodes: int = 0,
) -> ContactSolution:
    """Solve eq. CF.12.

    Args:
        blocks: inner (solid) and outer (tube).
        tissue: without a depth, a half-space.
        spheres: any number.
        target: which sphere the slope is of.
        bonded: whether shear is carried; frictionless otherwise.
        nodes: of the integrals over wave numbers.
        side_nodes: of those for the tissue's sides, 0 where they are far.
    """
    works = _half_space(blocks, tissue)
    for work, own in zip(works, zip(*_ends(blocks, bonded), strict=True), strict=True):
        work += _diagonal(own)
    C = _joined(works) if bonded else works[0]
    areas = _areas(blocks, C)
    if tissue.depth is not None or spheres:
        field, loads, weights = _waves(blocks, tissue, spheres, nodes, bonded)
        if tissue.depth is not None:
            C = C + _floor(field, loads, weights, tissue.mu)
        sides = _sides(blocks, tissue, side_nodes, bonded) if side_nodes else None
        C = C if sides is None else C + sides.work
    before, rest, slope, softer, marked = np.linalg.solve(C, areas), 0.0, np.zeros_like(areas[:, :2]), C, None
    for k, sphere in enumerate(spheres):
        check_time("inclusions")
        body = polarised(sphere, field, loads, weights, E=tissue.E, nu=tissue.nu, disc=_disc(blocks, tissue), sides=sides)
        forces, by_log = body.rest(before)
        softer, rest = softer - body.works, rest + forces
        if k == target:
            marked, slope = body, by_log
    tractions = np.linalg.solve(softer, areas) if spheres else before
    forces = np.swapaxes(areas, 1, 2) @ tractions + rest
    slope = slope if marked is None else slope + marked.slope(tractions)
    return ContactSolution(forces, slope, softer, areas, tractions)


def _ends(blocks: tuple[ElasticBlocks, ElasticBlocks], bonded: bool) -> list[tuple[Array, Array, Array]]:
    return [end_compliance(block, loads, bonded) for block, loads in zip(blocks, (SOLID, TUBE), strict=True)]


def _diagonal(parts: tuple[Array, Array]) -> Array:
    one, other = parts
    n, a, b = one.shape
    full = np.zeros((n, a + other.shape[1], b + other.shape[2]), dtype=one.dtype)
    full[:, :a, :b], full[:, a:, b:] = one, other
    return full


def _joined(works: Sequence[Array]) -> Array:
    """One symmetric matrix of the works of pressures, shears and pressures on shears."""
    pressure, shear, cross = works
    above = np.concatenate([pressure, cross], axis=2)
    return np.concatenate([above, np.concatenate([np.swapaxes(cross, 1, 2), shear], axis=2)], axis=1)


def _areas(blocks: tuple[ElasticBlocks, ElasticBlocks], like: Array) -> Array:
    """Force of each load on each block, shape (n, loads, 2)."""
    areas = np.zeros((len(like), like.shape[1], 2), dtype=like.dtype)
    row = 0
    for i, (block, loads) in enumerate(zip(blocks, (SOLID, TUBE), strict=True)):
        r = block.radii(loads.cuts)
        rings = np.pi * block.width[:, None] * np.diff(loads.cuts) * (r[:, 1:] + r[:, :-1])
        areas[:, row : row + loads.pressure.shape[1], i] = rings @ loads.pressure
        row += loads.pressure.shape[1]
    return areas


def _half_space(blocks: tuple[ElasticBlocks, ElasticBlocks], tissue: Tissue) -> list[Array]:
    """Works of pressures, shears, pressures on shears: those between discs, combined as rings are differences of discs."""
    inner, outer = (block.radii(loads.cuts) for block, loads in zip(blocks, (SOLID, TUBE), strict=True))
    circles = np.concatenate([inner[:, 1:], outer], axis=1)
    count = len(SOLID.cuts) - 1
    radius = np.stack([block.radius for block in blocks], axis=1)[:, [0] * count + [1] * (count + 2 - 1)]
    works = ring_work(circles, radius, tissue.mu, tissue.nu)
    sides = ((_DISCS[0], _DISCS[0]), (_DISCS[1], _DISCS[1]), _DISCS)
    return [_combined(work, left, right) for work, (left, right) in zip(works, sides, strict=True)]


def _combined(work: Array, left: Any, right: Any) -> Array:
    """left^T work right for matrices (n, i, j) whose n is last in memory."""
    rows = np.moveaxis(work, 0, 2)
    halves = (left.T @ rows.reshape(len(left), -1)).reshape(-1, *rows.shape[1:])
    return np.moveaxis(right.T @ halves, 2, 0).copy()


def _discs() -> tuple[Any, Any]:
    """The matrices that make the loads' functions of discs, shapes (circles, functions)."""
    count = len(SOLID.cuts) - 1
    inner = (np.eye(count + 1) - np.eye(count + 1, k=1))[1:, 1:]
    outer = np.vstack([-np.eye(count), np.zeros(count)]) + np.vstack([np.zeros(count), np.eye(count)])
    transforms = []
    for kind in ("pressure", "shear"):
        solid, tube = inner @ getattr(SOLID, kind), outer @ getattr(TUBE, kind)
        rows = np.zeros((2 * count + 1, solid.shape[1] + tube.shape[1]))
        rows[:count, : solid.shape[1]], rows[count:, solid.shape[1] :] = solid, tube
        transforms.append(rows)
    return transforms[0], transforms[1]


_DISCS = _discs()


@lru_cache(maxsize=64)
def _between_waves(nodes: int) -> tuple[Any, Any]:
    """Shares of the reach of wave numbers and their weights: Gauss's, denser among the long waves."""
    s, weight = legendre.leggauss(nodes)
    s = (s + 1) / 2
    return 0.8 * s**2 + 0.2 * s, (1.6 * s + 0.2) * weight / 2


def _waves(
    blocks: tuple[ElasticBlocks, ElasticBlocks], tissue: Tissue, spheres: Sequence[SphereArray], nodes: int, bonded: bool
) -> tuple[Waves, tuple[Array, Array], Array]:
    """The wave numbers, transforms of the rings' loads, shapes (n, q, rings), and the weights k dk."""
    reaches = [REACH / (sphere.depth - 0.8 * sphere.radius) for sphere in spheres]
    reach = reduce(_larger, reaches) if reaches else FLOOR_REACH / tissue.depth
    across = blocks[1].radius + reduce(_larger, [sphere.offset for sphere in spheres], 0 * blocks[1].radius)
    resolved = (nodes - 8) / (NODES_PER_WAVE * across)  # of a sphere tiny beside the probe no more matters
    reach = np.where(reach.real < resolved.real, reach, resolved)
    share, weight = _between_waves(nodes)
    k = reach[:, None] * share
    weights = k * reach[:, None] * weight
    return waves(k, tissue.depth, tissue.nu), _transforms(blocks, k, bonded), weights


def _transforms(blocks: tuple[ElasticBlocks, ElasticBlocks], k: Array, bonded: bool) -> tuple[Array, Array]:
    """Hankel transforms of the pressures and of the shears, none unless bonded, at waves k (n, q); shapes (n, q, loads)."""
    radii = np.concatenate([block.radii(loads.radii) for block, loads in zip(blocks, (SOLID, TUBE), strict=True)], axis=1)
    zero, one = bessel(k[:, :, None] * radii[:, None, :])
    outer = np.repeat(np.stack([block.radius for block in blocks], axis=1), RADII, axis=1)
    rings = radii * np.repeat(np.stack([block.width for block in blocks], axis=1), RADII, axis=1)
    pressure = batched_matmul(zero * rings[:, None, :], _CONCENTRATED[0])
    if not bonded:
        return pressure, pressure[:, :, :0]
    return pressure, batched_matmul(one * (rings * radii / outer)[:, None, :], _CONCENTRATED[1])


def _sides(blocks: tuple[ElasticBlocks, ElasticBlocks], tissue: Tissue, nodes: int, bonded: bool) -> Sides:
    """What free sides add, eq. CF.11."""
    k, weights = cut_waves(tissue.radius, blocks[1].radius, nodes)
    field = waves(k, tissue.depth, tissue.nu)
    cylinder = ElasticBlocks(None, tissue.radius, tissue.depth, tissue.E, tissue.nu)
    return free_sides(field, _transforms(blocks, k, bonded), weights, cylinder)


def _disc(blocks: tuple[ElasticBlocks, ElasticBlocks], tissue: Tissue) -> Disc:
    """Both ends as one: they give way as half-spaces do, in the mean over their areas."""
    area = blocks[0].area + blocks[1].area

    def ends(share: float) -> Array:
        return sum(block.area / area * (1 - share * block.nu) * 2 * (1 + block.nu) / block.E for block in blocks)

    pressed, sheared = (1 - tissue.nu) / tissue.mu + ends(1.0), (1 - tissue.nu / 2) / tissue.mu + ends(0.5)
    return Disc(blocks[1].radius, pressed, sheared)


def _larger(one: Array, other: Array) -> Array:
    """The one with the larger real part: a complex step has no other order."""
    return np.where(one.real > other.real, one, other)


def _concentrated() -> tuple[Any, Any]:
    """Matrices from values at the radii to transforms of the loads, shapes (radii, functions)."""
    densities = [[loads.concentrated(getattr(loads, kind)) for loads in (SOLID, TUBE)] for kind in ("pressure", "shear")]
    return tuple(_diagonal((one[None], other[None]))[0] for one, other in densities)


_CONCENTRATED = _concentrated()


def _floor(field: Waves, loads: tuple[Array, Array], weights: Array, mu: Array) -> Array:
    """What the floor adds: 2 pi Int loads x eq. CF.6 k dk."""
    scale = (np.pi / mu)[:, None, None]
    parts = [weights[:, :, None] * part[:, :, None] for part in floor_compliance(field)]
    p, q = loads
    pt, qt = np.swapaxes(p, 1, 2), np.swapaxes(q, 1, 2)
    return scale * _joined((pt @ (parts[0] * p), qt @ (parts[1] * q), pt @ (parts[2] * q)))
