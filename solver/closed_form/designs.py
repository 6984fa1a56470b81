"""Evaluate the closed form on arrays of designs, and differentiate it by complex steps.

``compute_products`` evaluates ``contact.solve_contact`` on arrays of designs, whose numbers may be complex: with an imaginary
part of 1e-30 of a parameter, that of forces and charges is their derivative, exact to rounding. ``evaluator`` does so on scenes.
"""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.film import RIGID_BOND, Film
from geometry.scenes.fit_check import compute_offset
from geometry.scenes.scene import Scene
from solver.closed_form.bessel import Array
from solver.closed_form.contact import (
    FLOOR_REACH,
    INTEGRAL_REACH,
    MIN_WAVE_NODES,
    NODES_PER_WAVE,
    ContactSolution,
    Films,
    Shared,
    solve_contact,
)
from solver.closed_form.contact import Tissue as TissueArray
from solver.closed_form.film_membrane import FILM_PARAMETERS, FilmArray
from solver.closed_form.lateral_boundary import count_side_nodes
from solver.closed_form.layered_works import count_layer_nodes
from solver.closed_form.sphere_moments import SphereArray
from solver.closed_form.tractions import BlockPair, ElasticBlocks
from solver.layers.scene_layers import list_material_layers
from solver.layers.stack import TissueLayer
from solver.linalg.memory import keep_freed

PROBE_PARAMETERS = (
    "inner_radius", "gap", "outer_radius", "inner_height", "outer_height",
    "inner_modulus", "inner_poisson", "outer_modulus", "outer_poisson",
)  # fmt: skip
TISSUE_PARAMETERS = ("tissue_depth", "tissue_radius", "tissue_modulus", "tissue_poisson")
SPHERE_PARAMETERS = ("radius", "depth", "offset", "modulus", "poisson")
LAYER_PARAMETERS = ("layer_thickness", "layer_modulus", "layer_poisson")
MAX_WAVE_NODES = 256  # nodes of the integrals over wave numbers
MIN_FACE_GAP_DIAMETERS = 0.05  # gap between a sphere's points and a face, in its diameters; ``evaluator`` refuses smaller ones
# designs at a time, so that the work arrays stay in the processor's cache; columns of a power of two would share its lines
DESIGNS_PER_CHUNK = 520
_HASH_WEIGHTS = np.sqrt(np.arange(2.0, 64.0))  # weights of the sum by which equal probes and tissues are recognised


@dataclass(frozen=True)
class Shape:
    """The structure of the closed form: the kind of scene that it describes.

    Attributes
    ----------
    on_axis
        For each inclusion, whether its centre lies on the probe's axis.
    target
        Index of the inclusion by whose modulus the forces are differentiated; None for none.
    nodes
        Number of nodes of the integrals over wave numbers.
    bonded
        Whether blocks and tissue stick; frictionless otherwise.
    bounded
        Whether the tissue has a bottom at ``tissue_depth``; a half-space otherwise.
    side_nodes
        Number for the integrals of the tissue's sides at ``tissue_radius``; 0 where they are far.
    sphere_layers
        For each inclusion, the index of the layer that holds it, the tissue's own material last.
    layers
        How many layers of other materials the tissue has.
    layer_nodes
        Number of nodes of the integral for these.
    films
        Whether the films' charges are computed, see ``FILM_PARAMETERS``.
    insets
        Whether a film's electrode ends within its edges.
    """

    on_axis: tuple[bool, ...] = (True,)
    target: int | None = 0
    nodes: int = 16
    bonded: bool = True
    bounded: bool = True
    side_nodes: int = 0
    sphere_layers: tuple[int, ...] = (0,)
    layers: int = 0
    layer_nodes: int = 0
    films: bool = False
    insets: bool = False


def _solve_columns(shape: Shape, p: Array, reuse: bool) -> ContactSolution:
    """Solve the contact for parameters p of n designs, shape (parameters, n), in the order of ``compute_forces``.

    With ``reuse``, what designs with the same probe and tissue have in common is computed once.
    """
    depth, side, modulus, poisson = p[len(PROBE_PARAMETERS) : len(PROBE_PARAMETERS) + len(TISSUE_PARAMETERS)]
    bodies, layers, film_rows = split_parameters(shape, p)
    films = Films(FilmArray(*film_rows[0]), FilmArray(*film_rows[1]), shape.insets) if shape.films else None
    tissue_layers = tuple(TissueLayer(*layer) for layer in layers)
    tissue = TissueArray(depth if shape.bounded else None, modulus, poisson, side, tissue_layers)
    spheres = [
        SphereArray(b[0], b[1], offset=b[2], E=b[3], nu=b[4], on_axis=on_axis, layer=place)
        for b, on_axis, place in zip(bodies, shape.on_axis, shape.sphere_layers, strict=True)
    ]
    shared = None
    if reuse:
        rows = [p[: len(PROBE_PARAMETERS) + len(TISSUE_PARAMETERS)], layers.reshape(-1, p.shape[1])]
        shared = _find_shared(np.concatenate([*rows, film_rows.reshape(-1, p.shape[1])]))
    return solve_contact(
        build_blocks(p),
        tissue,
        spheres,
        target=shape.target,
        bonded=shape.bonded,
        nodes=shape.nodes,
        side_nodes=shape.side_nodes,
        layer_nodes=shape.layer_nodes,
        shared=shared,
        films=films,
    )


def build_blocks(parameters: Array) -> BlockPair:
    """Build the inner and the outer blocks of n designs from parameters (parameters, n), PROBE_PARAMETERS the first of them."""
    inner_radius, gap, outer_radius, inner_height, outer_height, *materials = parameters[: len(PROBE_PARAMETERS)]
    inner = ElasticBlocks(None, inner_radius, inner_height, *materials[:2])
    return inner, ElasticBlocks(inner_radius + gap, outer_radius, outer_height, *materials[2:])


def _find_shared(rows: Array) -> Shared | None:
    """Find equal columns of an array (numbers, n); None where more than half are distinct, as little would be saved.

    Columns with equal weighted sums of their numbers are compared; None, too, if they then differ.
    """
    with np.errstate(invalid="ignore"):
        _, first, which = np.unique(_HASH_WEIGHTS[: len(rows)] @ rows, return_index=True, return_inverse=True)
    if 2 * len(first) > rows.shape[1] or not (rows[:, first[which]] == rows).all():
        return None
    return Shared(first, which)


def split_parameters(shape: Shape, values: Array) -> tuple[Array, Array, Array]:
    """Return views of the parameters of inclusions, layers and films.

    Their shapes are (inclusions, 5, n), (layers, 3, n) and (films, 12, n); there are two films or none.
    """
    start = len(PROBE_PARAMETERS) + len(TISSUE_PARAMETERS)
    counts = [len(SPHERE_PARAMETERS) * len(shape.on_axis), len(LAYER_PARAMETERS) * shape.layers]
    bodies, layers, films = np.split(values[start:], np.cumsum(counts))
    rows = (SPHERE_PARAMETERS, LAYER_PARAMETERS, FILM_PARAMETERS)
    views = [part.reshape(-1, len(names), *values.shape[1:]) for part, names in zip((bodies, layers, films), rows, strict=True)]
    return views[0], views[1], views[2]


def compute_products(shape: Shape, values: Array) -> tuple[Array, Array]:
    """Evaluate forces and, of films, charges of many designs at once.

    Parameters
    ----------
    shape
        See ``Shape``; ``build_parameters`` makes it from a scene.
    values
        The parameters PROBE_PARAMETERS, TISSUE_PARAMETERS, then SPHERE_PARAMETERS for each inclusion, LAYER_PARAMETERS for each
        layer and, where the shape has films, FILM_PARAMETERS for the inner and for the outer film, SI, a column for each design;
        shape (parameters, n).

    Returns
    -------
    tuple[Array, Array]
        The forces F_ij on film i per unit displacement of base j, N/m, with films below them their charges Q_ij, C/m, and their
        derivatives by the logarithm of the target's Young's modulus (zero without a target), both of shape (n, 2 or 4, 2).
        Designs outside the formulas' range are not refused; where the equations are singular the values are NaN.
    """
    parts = list(iterate_solutions(shape, values, reuse=True))
    return np.concatenate([part.products for part in parts]), np.concatenate([part.product_derivatives for part in parts])


def compute_forces(shape: Shape, values: Array) -> tuple[Array, Array]:
    """Evaluate the forces alone of many designs, about 25 000 a second on one core with one inclusion on the axis.

    Arguments and results are those of ``compute_products``, the latter of shape (n, 2, 2).
    """
    products, derivatives = compute_products(shape, values)
    return products[:, :2], derivatives[:, :2]


def iterate_solutions(shape: Shape, values: Array, *, reuse: bool = False) -> Iterator[ContactSolution]:
    """Yield the contact solutions of the designs, some designs at a time.

    With ``reuse``, what designs with the same probe and tissue have in common is computed once; rounding then differs slightly.
    """
    values = np.asarray(values)
    chunk = DESIGNS_PER_CHUNK // 2 if shape.layers else DESIGNS_PER_CHUNK  # layers take more waves
    if values.shape[1] >= chunk:
        keep_freed()
    for k in range(0, values.shape[1], chunk):
        try:
            yield _solve_columns(shape, values[:, k : k + chunk], reuse)
        except np.linalg.LinAlgError:
            yield from (_solve_alone(shape, column) for column in values[:, k : k + chunk].T)


def _solve_alone(shape: Shape, column: Array) -> ContactSolution:
    """Solve one design; NaN if its equations are singular."""
    try:
        return _solve_columns(shape, column[:, None], reuse=False)
    except np.linalg.LinAlgError:
        states = 4 if shape.films else 2
        nan, no_loads = np.full((1, states, 2), np.nan, dtype=column.dtype), np.full((1, 1, states), np.nan)
        return ContactSolution(nan, nan, np.full((1, 1, 1), np.nan), no_loads, no_loads)


def build_parameters(scene: Scene, *, merged: bool = True) -> tuple[Shape, Floats]:
    """Return the formula's structure for a scene and the values of its parameters, SI.

    Layers of one material are one, unless ``merged`` is False: then every layer of the scene has its parameters.
    """
    probe, tissue = scene.probe, scene.tissue
    values = [probe.inner_radius, probe.gap, probe.tube_radius, probe.core_height, probe.tube_height]
    for block in (probe.inner, probe.outer):
        values += [block.youngs_modulus, block.poisson_ratio]
    # a half-space has neither depth nor sides: its numbers are not used
    depth, side = (1.0, 1.0) if tissue.shape == "half-space" else (tissue.depth, tissue.side_radius)
    values += [depth, side, tissue.youngs_modulus, tissue.poisson_ratio]
    offsets = [compute_offset(scene, body) for body in scene.inclusion]
    for body, offset in zip(scene.inclusion, offsets, strict=True):
        values += [(body.diameter or 0.0) / 2, body.depth, offset, body.youngs_modulus, body.poisson_ratio]
    on_axis = tuple(offset <= 1e-9 * (body.diameter or 1.0) for body, offset in zip(scene.inclusion, offsets, strict=True))
    bonded, bounded = scene.contact.interface == "bonded", tissue.shape != "half-space"
    layers = list_material_layers(tissue, merged)
    for layer in layers:
        values += layer
    film = probe.film
    by_block = film.by_block if film is not None and not film.uses_psi else ()
    for block_film in by_block:
        values += _list_film_parameters(block_film)
    faces = list(accumulate(layer[0] for layer in layers))
    shape = Shape(
        on_axis,
        scene.target,
        _count_wave_nodes(scene, faces),
        bonded,
        bounded,
        count_side_nodes(probe.tube_radius, depth, side) if bounded else 0,
        sphere_layers=tuple(bisect(faces, body.depth) for body in scene.inclusion),
        layers=len(layers),
        layer_nodes=count_layer_nodes(probe.tube_radius, layers[0][0]) if layers else 0,
        films=bool(by_block),
        insets=any(block_film.electrode_inset > 0 for block_film in by_block),
    )
    return shape, np.array(values)


def _list_film_parameters(film: Film) -> list[float]:
    """Return FILM_PARAMETERS of one film; a rigid bond has no thickness, and the film's constants."""
    values = [film.thickness, film.youngs_modulus, film.poisson_ratio, film.mean_lateral_charge, film.d33, film.electrode_inset]
    for bond in (film.bond_to_base or RIGID_BOND, film.bond_to_block or RIGID_BOND):
        modulus = film.youngs_modulus if bond.youngs_modulus is None else bond.youngs_modulus
        values += [bond.thickness, modulus, film.poisson_ratio if bond.poisson_ratio is None else bond.poisson_ratio]
    return values


def _count_wave_nodes(scene: Scene, faces: list[float]) -> int:
    """Return how many nodes the integrals over wave numbers need, an even number.

    They resolve waves that decay over the shortest path, from a sphere's points (up to 0.4 diameters from its centre) to the
    surface or to another face and back, and that oscillate across the probe. ``faces`` are the depths of layers' interfaces, m.
    """
    faces = [*faces, scene.tissue.bottom]
    # maximum wave numbers, 1/m; a path to a face and back counts twice, hence the half below
    reach = [INTEGRAL_REACH / (body.depth - 0.4 * (body.diameter or 0.0)) for body in scene.inclusion]
    for body in scene.inclusion:
        size = body.diameter or 0.0
        reach += [INTEGRAL_REACH / 2 / max(abs(body.depth - face) - 0.4 * size, MIN_FACE_GAP_DIAMETERS * size) for face in faces]
    reach.append(FLOOR_REACH / scene.tissue.bottom)
    across = scene.probe.tube_radius + max((compute_offset(scene, body) for body in scene.inclusion), default=0.0)
    needed = MIN_WAVE_NODES + NODES_PER_WAVE * max(reach) * across
    return min(MAX_WAVE_NODES, 2 * math.ceil(needed / 2))
