"""Contact of two blocks with a layer that holds spheres: tractions and forces for many designs at once.

Unknown are pressures p and, where bonded, shears q on rings under both blocks. With C the work of unit loads' displacements on
each other, of tissue and blocks' ends, and A_j the areas of the rings under block j,

    C t_j = A_j,   F_ij = A_i^T t_j                                                                 (CF.12)

for block j's base moved by one unit, to which the spheres add eq. CF.14 of ``inclusions``. On a half-space C is closed
(``half_space``); the bottom and the spheres take integrals over wave numbers, in which a ring's load is its values at few
radii, exact for polynomials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import accumulate
from typing import Any

import numpy as np

from geometry.common.arrays import Ints
from geometry.common.resources import check_time
from solver.closed_form.bessel import Array
from solver.closed_form.block_compliance import compute_end_compliance
from solver.closed_form.film_loads import compute_film_loads
from solver.closed_form.film_membrane import FilmArray
from solver.closed_form.half_space import compute_disc_works
from solver.closed_form.inclusions import build_loaded_spheres
from solver.closed_form.lateral_boundary import Sides, build_cut_waves, solve_free_sides
from solver.closed_form.layer import solve_waves
from solver.closed_form.layered_spheres import build_sphere_in_layer
from solver.closed_form.layered_works import compute_disc_compliances, compute_layered_works, find_stiffest
from solver.closed_form.off_axis import Disc
from solver.closed_form.sphere_moments import SphereArray
from solver.closed_form.tractions import (
    LOADS,
    BlockPair,
    ElasticBlocks,
    build_wave_rule,
    combine_disc_works,
    compute_load_areas,
    join_works,
    list_disc_radii,
    transform_long_waves,
)
from solver.layers.stack import TissueLayer, compute_floor_change

INTEGRAL_REACH = 10.0  # exponent at which the integrals over wave numbers are cut off
FLOOR_REACH = 6.0
MIN_PATH_RADII = 0.1  # in radii, for a sphere that an interface cuts; ``evaluator`` refuses such scenes
NODES_PER_WAVE, MIN_WAVE_NODES = 0.35, 8  # nodes per wave number times outermost radius, and those that long waves need


@dataclass(frozen=True)
class Tissue:
    """The tissues of n designs; arrays of shape (n,), SI.

    Attributes
    ----------
    depth
        Of the rigid bottom, m; None for half-spaces.
    E, nu
        Young's modulus, Pa, and Poisson's ratio of the tissue's own material.
    radius
        Of the free sides, m; used where they are near.
    layers
        Layers of other materials above, from the surface downwards.
    """

    depth: Any
    E: Array
    nu: Array
    radius: Any = None
    layers: tuple[TissueLayer, ...] = ()

    def take(self, which: Ints) -> Tissue:
        """Return the tissue of the designs with indices ``which``."""
        depth, radius = (None if part is None else part[which] for part in (self.depth, self.radius))
        layers = tuple(TissueLayer(layer.thickness[which], layer.E[which], layer.nu[which]) for layer in self.layers)
        return Tissue(depth, self.E[which], self.nu[which], radius, layers)

    @property
    def mu(self) -> Array:
        """Shear modulus of the tissue's own material, Pa."""
        return self.E / (2 * (1 + self.nu))

    @property
    def stack(self) -> tuple[TissueLayer, ...]:
        """All layers, the tissue's own material the last."""
        left = None if self.depth is None else self.depth - sum(layer.thickness for layer in self.layers)
        return (*self.layers, TissueLayer(left, self.E, self.nu))

    @property
    def faces(self) -> list[Array]:
        """Depths of interfaces and bottom, m: like the surface they reflect the field of a sphere."""
        faces = list(accumulate(layer.thickness for layer in self.layers))
        return faces if self.depth is None else [*faces, self.depth]


@dataclass(frozen=True)
class Films:
    """The films of n designs.

    Attributes
    ----------
    inner, outer
        Of either block.
    insets
        Whether any electrode ends within its film's edges.
    """

    inner: FilmArray
    outer: FilmArray
    insets: bool

    @property
    def count(self) -> int:
        """How many designs these are."""
        return len(self.inner.thickness)

    def take(self, which: Ints) -> Films:
        """Return the films of the designs with indices ``which``."""
        return Films(self.inner.take(which), self.outer.take(which), self.insets)


@dataclass(frozen=True)
class ContactSolution:
    """Forces, charges and tractions of n designs.

    Attributes
    ----------
    products
        Forces F_ij, N/m, and, with films, below them their charges Q_ij, C/m: shape (n, s, 2), s = 2 or 4.
    product_derivatives
        Their derivatives by ln of the target's modulus, zero without one.
    works, areas, tractions
        C, A and t of eq. CF.12, shapes (n, loads, loads), (n, loads, s) and (n, loads, s); the films' loads m (eq. CF.28) follow
        the areas.
    """

    products: Array
    product_derivatives: Array
    works: Array
    areas: Array
    tractions: Array

    @property
    def forces(self) -> Array:
        """F_ij, N/m, shape (n, 2, 2)."""
        return self.products[:, :2]

    @property
    def residual(self) -> Array:
        """Residual of eq. CF.12, relative to the largest sum of the absolute values of its terms, shape (n,)."""
        unbalanced = np.abs(self.works @ self.tractions - self.areas)
        return unbalanced.max(axis=(1, 2)) / (np.abs(self.works) @ np.abs(self.tractions)).max(axis=(1, 2))


def solve_contact(
    blocks: BlockPair,
    tissue: Tissue,
    spheres: Sequence[SphereArray],
    *,
    target: int | None,
    bonded: bool,
    nodes: int,
    side_nodes: int = 0,
    layer_nodes: int = 0,
    shared: Shared | None = None,
    films: Films | None = None,
) -> ContactSolution:
    """Solve the contact equations (eq. CF.12) with the spheres' corrections (eq. CF.14).

    Parameters
    ----------
    blocks
        Inner (solid) and outer (tube).
    tissue
        The tissues; half-spaces where they have no depth.
    spheres
        The inclusions of each design, any number.
    target
        Index of the sphere by whose modulus the forces are differentiated; None for none.
    bonded
        Whether shear is carried; frictionless otherwise.
    nodes
        Number of nodes of the integrals over wave numbers.
    side_nodes
        Number for the integrals of the tissue's sides, 0 where they are far.
    layer_nodes
        Number for the integral of its layers.
    shared
        Which designs have the same blocks, films and tissue, whose works are then computed once; None to compute all.
    films
        The films whose charges are wanted; None for forces alone.
    """
    C, A, sides = _assemble_without_spheres(blocks, tissue, (side_nodes, layer_nodes), bonded, shared=shared, films=films)
    if tissue.depth is not None or spheres:
        stiffest = find_stiffest(tissue.stack) if tissue.layers else tissue
        k, loads, weights = _choose_waves(blocks, tissue, spheres, nodes, bonded)
        if tissue.depth is not None:
            C = C + _compute_floor_works(k, TissueLayer(tissue.depth, stiffest.E, stiffest.nu), loads, weights)
    bare_tractions, higher_moment_forces, derivative, softened_works, target_body = (
        np.linalg.solve(C, A),
        0.0,
        np.zeros_like(A[:, : A.shape[2]]),
        C,
        None,
    )
    # tractions without spheres give what eq. CF.13 has beyond the moments; the moments act through C, so that tractions give way
    for index, sphere in enumerate(spheres):
        check_time("inclusions")
        # the disc stands for the blocks' response to fields that are not symmetric about the probe's axis
        layer, disc = tissue.stack[sphere.layer], None if sphere.on_axis else _build_disc(blocks, tissue, layer_nodes)
        in_layer = build_sphere_in_layer(sphere, k, weights, tissue.stack, tissue.depth is not None)
        body = build_loaded_spheres(sphere, in_layer, loads, weights, layer=layer, disc=disc, sides=sides)
        forces, by_log = body.compute_higher_moments(bare_tractions)
        softened_works, higher_moment_forces = softened_works - body.works, higher_moment_forces + forces
        if index == target:
            target_body, derivative = body, by_log
    tractions = np.linalg.solve(softened_works, A) if spheres else bare_tractions
    products = A.swapaxes(1, 2) @ tractions + higher_moment_forces
    derivative = derivative if target_body is None else derivative + target_body.compute_log_modulus_derivative(tractions)
    return ContactSolution(products[:, :, :2], derivative[:, :, :2], softened_works, A, tractions)


@dataclass(frozen=True)
class Shared:
    """Designs that have the same blocks, films and tissue as others.

    Attributes
    ----------
    first
        Index of the first design of each kind, shape (kinds,).
    which
        The kind of each design, shape (n,).
    """

    first: Any
    which: Any


def _assemble_without_spheres(
    blocks: BlockPair, tissue: Tissue, nodes: tuple[int, int], bonded: bool, *, shared: Shared | None, films: Films | None
) -> tuple[Array, Array, Sides | None]:
    """Return C and A of eq. CF.12, A with the films' loads, and the sides, None where they are far.

    C leaves out the spheres and what ``_compute_floor_works`` adds. ``nodes`` are those for sides and for layers; with
    ``shared``, equal blocks and tissues are computed once.
    """
    if shared is not None:
        inner, outer = (block.take(shared.first) for block in blocks)
        used_films = None if films is None else films.take(shared.first)
        C, A, sides = _assemble_without_spheres(
            (inner, outer), tissue.take(shared.first), nodes, bonded, shared=None, films=used_films
        )
        return C[shared.which], A[shared.which], None if sides is None else sides.take(shared.which)
    works = _compute_works(blocks, tissue, nodes[1], bonded)
    C = join_works(works) if bonded else works[0]
    _add_end_compliances(C, blocks, bonded)
    sides = _compute_sides(blocks, tissue, nodes[0], bonded) if nodes[0] else None
    A = compute_load_areas(blocks, C)
    if films is not None:
        A = np.concatenate([A, _add_films(C, blocks, films, bonded)], axis=2)
    return C if sides is None else C + sides.work, A, sides


def _add_films(C: Array, blocks: BlockPair, films: Films, bonded: bool) -> Array:
    """Add the compliance of films and bonds to C, in place; return m of eq. CF.28 of each load and film, shape (n, loads, 2)."""
    parts = [
        compute_film_loads(block, film, films.insets) for block, film in zip(blocks, (films.inner, films.outer), strict=True)
    ]
    loads = np.zeros((*C.shape[:2], 2), dtype=np.result_type(C, *(part.charge for part in parts)))
    for film, (part, index) in enumerate(zip(parts, _list_block_loads(bonded), strict=True)):
        C[:, index[:, None], index] += part.compliance[:, : len(index), : len(index)]
        loads[:, index, film] = part.charge[:, : len(index)]
    return loads


def _list_block_loads(bonded: bool) -> tuple[Any, Any]:
    """Return the indices of the inner and of the outer block's loads; pressures of both come before shears of both."""
    loads = LOADS.loads
    counts = [loads[0].pressure.shape[1], loads[1].pressure.shape[1], *(load.shear.shape[1] for load in loads if bonded)]
    places = np.split(np.arange(sum(counts)), np.cumsum(counts)[:-1])
    # even positions belong to the inner block, odd ones to the outer
    return np.concatenate(places[::2]), np.concatenate(places[1::2])


def _add_end_compliances(C: Array, blocks: BlockPair, bonded: bool) -> None:
    """Add the compliance of the blocks' ends to C, in place; pressures of both blocks come before shears of both."""
    for block, index in zip(blocks, _list_block_loads(bonded), strict=True):
        C[:, index[:, None], index] += compute_end_compliance(block, bonded)[:, : len(index), : len(index)]


def _compute_works(blocks: BlockPair, tissue: Tissue, layer_nodes: int, bonded: bool) -> list[Array]:
    """Return the works of pressures, shears and pressures on shears on the tissue, without ``_compute_floor_works``."""
    if tissue.layers:
        return compute_layered_works(blocks, tissue.stack, tissue.depth, layer_nodes, bonded)
    return combine_disc_works(blocks, compute_disc_works(*list_disc_radii(blocks), tissue.mu, tissue.nu))


def _choose_waves(
    blocks: BlockPair, tissue: Tissue, spheres: Sequence[SphereArray], nodes: int, bonded: bool
) -> tuple[Array, tuple[Array, Array], Array]:
    """Choose the wave numbers for bottom and spheres.

    Returns the wave numbers, 1/m, shape (n, q), the Hankel transforms of pressures and shears there, shapes (n, q, loads), and
    the weights k dk, shape (n, q).
    """
    reaches = [INTEGRAL_REACH / _find_shortest_path(sphere, tissue) for sphere in spheres]
    reach = reduce(_choose_larger, reaches) if reaches else FLOOR_REACH / tissue.depth
    across = blocks[1].radius + reduce(_choose_larger, [sphere.offset for sphere in spheres], 0 * blocks[1].radius)
    # what the nodes resolve: shorter waves do not matter for a sphere that is tiny compared with the probe
    resolved = (nodes - MIN_WAVE_NODES) / (NODES_PER_WAVE * across)
    reach = np.where(reach.real < resolved.real, reach, resolved)
    fractions, weight = build_wave_rule(nodes)
    k = reach[:, None] * fractions
    return k, transform_long_waves(blocks, k, bonded), k * reach[:, None] * weight


def _find_shortest_path(sphere: SphereArray, tissue: Tissue) -> Array:
    """Return the shortest path from a sphere's quadrature to the surface, or to another face and back, m."""
    path = sphere.depth - 0.8 * sphere.radius  # the highest points of the quadrature lie 0.8 radii above the centre
    for face in tissue.faces:
        face_path = np.where(face.real < sphere.depth.real, sphere.depth - face, face - sphere.depth) - 0.8 * sphere.radius
        # minima, as maxima of the negatives
        path = -_choose_larger(-path, -2 * _choose_larger(face_path, MIN_PATH_RADII * sphere.radius))
    return path


def _compute_sides(blocks: BlockPair, tissue: Tissue, nodes: int, bonded: bool) -> Sides:
    """Compute what free sides add to the works, eq. CF.11; layers count as one material, see ``_average_column``."""
    k, weights = build_cut_waves(tissue.radius, blocks[1].radius, nodes)
    E, nu = _average_column(tissue)
    cylinder = ElasticBlocks(None, tissue.radius, tissue.depth, E, nu)
    return solve_free_sides(solve_waves(k, tissue.depth, nu), transform_long_waves(blocks, k, bonded), weights, cylinder)


def _average_column(tissue: Tissue) -> tuple[Array, Array]:
    """Return modulus, Pa, and Poisson's ratio of one material whose column shortens and widens as that of the layers.

    Under one stress, layers shorten by thickness / E; these are also the weights of Poisson's ratios.
    """
    if not tissue.layers:
        return tissue.E, tissue.nu
    shortening = [layer.thickness / layer.E for layer in tissue.stack]
    total = sum(shortening)
    return tissue.depth / total, sum(part * layer.nu for part, layer in zip(shortening, tissue.stack, strict=True)) / total


def _build_disc(blocks: BlockPair, tissue: Tissue, layer_nodes: int) -> Disc:
    """Build the disc that stands for both blocks' ends in ``off_axis``.

    The ends have the compliance of half-spaces of their materials, averaged with the ends' areas; the tissue's is added.
    """
    area = blocks[0].area + blocks[1].area

    def compute_end_compliance(poisson_weight: float) -> Array:
        """Return the mean of (1 - poisson_weight nu) / mu of the ends: weight 1 for pressure, 1/2 for shear."""
        return sum(block.area / area * (1 - poisson_weight * block.nu) * 2 * (1 + block.nu) / block.E for block in blocks)

    if tissue.layers:
        pressed, sheared = compute_disc_compliances(
            blocks[1].radius, (*tissue.layers, TissueLayer(None, tissue.E, tissue.nu)), layer_nodes
        )
        return Disc(
            blocks[1].radius, pressed + compute_end_compliance(1.0)[:, None], sheared + compute_end_compliance(0.5)[:, None]
        )
    pressed, sheared = (
        (1 - tissue.nu) / tissue.mu + compute_end_compliance(1.0),
        (1 - tissue.nu / 2) / tissue.mu + compute_end_compliance(0.5),
    )
    return Disc(blocks[1].radius, pressed, sheared)


def _choose_larger(first: Array, second: Array) -> Array:
    """Return the value with the larger real part; complex steps have no other order."""
    return np.where(first.real > second.real, first, second)


def _compute_floor_works(k: Array, layer: TissueLayer, loads: tuple[Array, Array], weights: Array) -> Array:
    """Return what a bottom below one layer adds to C, shape (n, m, m) for m loads.

    It is 2 pi times the integral, over waves k (n, q) with ``weights`` k dk, of both loads' transforms times the bottom's change
    of the compliance.
    """
    scale = (np.pi / layer.mu)[:, :, None]
    parts = [(weights / k * part)[:, :, None] for part in compute_floor_change(k, layer)]
    p, q = loads
    p_transposed, q_transposed = p.swapaxes(1, 2), q.swapaxes(1, 2)
    return scale * join_works((p_transposed @ (parts[0] * p), q_transposed @ (parts[1] * q), p_transposed @ (parts[2] * q)))
