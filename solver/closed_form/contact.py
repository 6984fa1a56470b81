"""Contact of two blocks with a layer that holds spheres: tractions and forces for many designs at once.

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
from functools import reduce
from itertools import accumulate
from typing import TYPE_CHECKING, Any

import numpy as np

from geometry.common.resources import check_time
from solver.closed_form.bessel import Array
from solver.closed_form.block_compliance import ElasticBlocks, end_compliance
from solver.closed_form.half_space import ring_work
from solver.closed_form.inclusions import polarised
from solver.closed_form.lateral_boundary import Sides, cut_waves, free_sides
from solver.closed_form.layer import Waves, floor_compliance, waves
from solver.closed_form.layered_spheres import inside
from solver.closed_form.layered_works import disc_compliances, layered_works, stiffest
from solver.closed_form.off_axis import Disc
from solver.closed_form.surface_images import SphereArray
from solver.closed_form.tractions import areas, between_waves, circles, joined, long_waves, of_rings, pair_loads
from solver.layers.stack import TissueLayer

if TYPE_CHECKING:
    from solver.closed_form.tractions import Pair

REACH = 10.0  # exponent at which the integrals over wave numbers are cut off
FLOOR_REACH = 6.0
LEAST_WAY = 0.1  # in radii, for a sphere that an interface cuts; ``level`` refuses such scenes
NODES_PER_WAVE, LONG = 0.35, 8  # nodes per wave number times outermost radius, and those that long waves need


@dataclass(frozen=True)
class Tissue:
    """Tissue bonded to a floor at ``depth`` (None: half-spaces): modulus, Poisson's ratio; arrays of shape (n,), SI.

    ``radius`` is that of the free sides, if they are near; ``layers`` are of other materials, from the surface downwards.
    """

    depth: Any
    E: Array
    nu: Array
    radius: Any = None
    layers: tuple[TissueLayer, ...] = ()

    def take(self, which: Any) -> Tissue:
        """Return the tissue of the designs with indices ``which``."""
        depth, radius = (None if part is None else part[which] for part in (self.depth, self.radius))
        layers = tuple(TissueLayer(layer.thickness[which], layer.E[which], layer.nu[which]) for layer in self.layers)
        return Tissue(depth, self.E[which], self.nu[which], radius, layers)

    @property
    def mu(self) -> Array:
        """Shear modulus."""
        return self.E / (2 * (1 + self.nu))

    @property
    def stack(self) -> tuple[TissueLayer, ...]:
        """All layers, the tissue's own material the last."""
        left = None if self.depth is None else self.depth - sum(layer.thickness for layer in self.layers)
        return (*self.layers, TissueLayer(left, self.E, self.nu))

    @property
    def faces(self) -> list[Array]:
        """Depths of interfaces and floor, m: like the surface they reflect the field of a sphere."""
        faces = list(accumulate(layer.thickness for layer in self.layers))
        return faces if self.depth is None else [*faces, self.depth]


@dataclass(frozen=True)
class ContactSolution:
    """Forces and tractions of n designs.

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
        """Residual of eq. CF.12, relative to the largest sum of the absolute values of its terms, shape (n,)."""
        unbalanced = np.abs(self.works @ self.tractions - self.areas)
        return unbalanced.max(axis=(1, 2)) / (np.abs(self.works) @ np.abs(self.tractions)).max(axis=(1, 2))


def solve_contact(
    blocks: Pair,
    tissue: Tissue,
    spheres: Sequence[SphereArray],
    *,
    target: int | None,
    bonded: bool,
    nodes: int,
    side_nodes: int = 0,
    layer_nodes: int = 0,
    shared: Shared | None = None,
) -> ContactSolution:
    """Solve the contact equations (eq. CF.12) with the spheres' corrections (eq. CF.14).

    Args:
        blocks: inner (solid) and outer (tube).
        tissue: without a depth, a half-space.
        spheres: any number.
        target: which sphere the slope is of.
        bonded: whether shear is carried; frictionless otherwise.
        nodes: of the integrals over wave numbers.
        side_nodes: of those for the tissue's sides, 0 where they are far.
        layer_nodes: of those for its layers.
        shared: which designs have the same blocks and tissue.
    """
    C, A, sides = _without_spheres(blocks, tissue, (side_nodes, layer_nodes), bonded, shared)
    if tissue.depth is not None or spheres:
        firm = stiffest(tissue.stack) if tissue.layers else tissue
        k, loads, weights = _waves(blocks, tissue, spheres, nodes, bonded)
        field = waves(k, tissue.depth, firm.nu)
        if tissue.depth is not None:
            C = C + _floor(field, loads, weights, firm.E / (2 * (1 + firm.nu)))
    before, rest, slope, softer, marked = np.linalg.solve(C, A), 0.0, np.zeros_like(A[:, :2]), C, None
    for index, sphere in enumerate(spheres):
        check_time("inclusions")
        layer, disc = tissue.stack[sphere.layer], None if sphere.on_axis else _disc(blocks, tissue, layer_nodes)
        echoed = inside(sphere, k, weights, tissue.stack, tissue.depth is not None) if tissue.faces else None
        body = polarised(sphere, field, loads, weights, E=layer.E, nu=layer.nu, disc=disc, sides=sides, inside=echoed)
        forces, by_log = body.rest(before)
        softer, rest = softer - body.works, rest + forces
        if index == target:
            marked, slope = body, by_log
    tractions = np.linalg.solve(softer, A) if spheres else before
    forces = A.swapaxes(1, 2) @ tractions + rest
    slope = slope if marked is None else slope + marked.slope(tractions)
    return ContactSolution(forces, slope, softer, A, tractions)


@dataclass(frozen=True)
class Shared:
    """Designs that have the same blocks and tissue as others: the first of each kind, and which kind each is."""

    first: Any
    which: Any


def _without_spheres(
    blocks: Pair, tissue: Tissue, nodes: tuple[int, int], bonded: bool, shared: Shared | None
) -> tuple[Array, Array, Sides | None]:
    """Return C without the floor, A, and the sides; equal blocks and tissues are computed once."""
    if shared is not None:
        inner, outer = (block.take(shared.first) for block in blocks)
        C, A, sides = _without_spheres((inner, outer), tissue.take(shared.first), nodes, bonded, None)
        return C[shared.which], A[shared.which], None if sides is None else sides.take(shared.which)
    works = _works(blocks, tissue, nodes[1], bonded)
    C = joined(works) if bonded else works[0]
    _add_ends(C, blocks, bonded)
    sides = _sides(blocks, tissue, nodes[0], bonded) if nodes[0] else None
    return C if sides is None else C + sides.work, areas(blocks, C), sides


def _add_ends(C: Array, blocks: Pair, bonded: bool) -> None:
    """Add the compliance of the blocks' ends to C; pressures of both blocks come before shears of both."""
    loads = pair_loads(blocks).loads
    counts = [loads[0].pressure.shape[1], loads[1].pressure.shape[1], *(one.shear.shape[1] for one in loads if bonded)]
    places = np.split(np.arange(sum(counts)), np.cumsum(counts)[:-1])
    for block, own in zip(blocks, (places[::2], places[1::2]), strict=True):
        at = np.concatenate(own)
        C[:, at[:, None], at] += end_compliance(block, bonded)[:, : len(at), : len(at)]


def _works(blocks: Pair, tissue: Tissue, layer_nodes: int, bonded: bool) -> list[Array]:
    """Return works of pressures, shears and pressures on shears, without the floor, from those of discs."""
    if tissue.layers:
        return layered_works(blocks, tissue.stack, tissue.depth, layer_nodes, bonded)
    return of_rings(blocks, ring_work(*circles(blocks), tissue.mu, tissue.nu))


def _waves(
    blocks: Pair, tissue: Tissue, spheres: Sequence[SphereArray], nodes: int, bonded: bool
) -> tuple[Array, tuple[Array, Array], Array]:
    """Choose the wave numbers; return them, the transforms of the loads, shapes (n, q, loads), and the weights k dk."""
    reaches = [REACH / _way(sphere, tissue) for sphere in spheres]
    reach = reduce(_larger, reaches) if reaches else FLOOR_REACH / tissue.depth
    across = blocks[1].radius + reduce(_larger, [sphere.offset for sphere in spheres], 0 * blocks[1].radius)
    resolved = (nodes - LONG) / (NODES_PER_WAVE * across)  # shorter waves do not matter for a sphere tiny beside the probe
    reach = np.where(reach.real < resolved.real, reach, resolved)
    share, weight = between_waves(nodes)
    k = reach[:, None] * share
    return k, long_waves(blocks, k, bonded), k * reach[:, None] * weight


def _way(sphere: SphereArray, tissue: Tissue) -> Array:
    """Return the shortest path from a sphere's quadrature to the surface, or to another face and back, m."""
    way = sphere.depth - 0.8 * sphere.radius
    for face in tissue.faces:
        least = np.where(face.real < sphere.depth.real, sphere.depth - face, face - sphere.depth) - 0.8 * sphere.radius
        way = -_larger(-way, -2 * _larger(least, LEAST_WAY * sphere.radius))
    return way


def _sides(blocks: Pair, tissue: Tissue, nodes: int, bonded: bool) -> Sides:
    """Compute what free sides add to the works, eq. CF.11."""
    k, weights = cut_waves(tissue.radius, blocks[1].radius, nodes)
    E, nu = _column(tissue)
    cylinder = ElasticBlocks(None, tissue.radius, tissue.depth, E, nu)
    return free_sides(waves(k, tissue.depth, nu), long_waves(blocks, k, bonded), weights, cylinder)


def _column(tissue: Tissue) -> tuple[Array, Array]:
    """Return modulus and Poisson's ratio of one material whose column shortens and widens as that of the layers."""
    if not tissue.layers:
        return tissue.E, tissue.nu
    shortening = [layer.thickness / layer.E for layer in tissue.stack]
    whole = sum(shortening)
    return tissue.depth / whole, sum(share * layer.nu for share, layer in zip(shortening, tissue.stack, strict=True)) / whole


def _disc(blocks: Pair, tissue: Tissue, layer_nodes: int) -> Disc:
    """Build the disc that stands for both ends: each has the compliance of a half-space, averaged over the areas."""
    area = blocks[0].area + blocks[1].area

    def ends(share: float) -> Array:
        return sum(block.area / area * (1 - share * block.nu) * 2 * (1 + block.nu) / block.E for block in blocks)

    if tissue.layers:
        pressed, sheared = disc_compliances(
            blocks[1].radius, (*tissue.layers, TissueLayer(None, tissue.E, tissue.nu)), layer_nodes
        )
        return Disc(blocks[1].radius, pressed + ends(1.0)[:, None], sheared + ends(0.5)[:, None])
    pressed, sheared = (1 - tissue.nu) / tissue.mu + ends(1.0), (1 - tissue.nu / 2) / tissue.mu + ends(0.5)
    return Disc(blocks[1].radius, pressed, sheared)


def _larger(one: Array, other: Array) -> Array:
    """Return the value with the larger real part; complex steps have no other order."""
    return np.where(one.real > other.real, one, other)


def _floor(field: Waves, loads: tuple[Array, Array], weights: Array, mu: Array) -> Array:
    """Return what the floor adds to C: 2 pi times the integral of loads times the floor's compliance (eq. CF.6) k dk."""
    scale = (np.pi / mu)[:, None, None]
    parts = [weights[:, :, None] * part[:, :, None] for part in floor_compliance(field)]
    p, q = loads
    pt, qt = p.swapaxes(1, 2), q.swapaxes(1, 2)
    return scale * joined((pt @ (parts[0] * p), qt @ (parts[1] * q), pt @ (parts[2] * q)))
