"""Build tables of readings: sample effects at Chebyshev points, reduce their rank, measure the error, cache the result on disk.

Effects to first order cost little and are sampled on many points; the change by reflections, much smoother, on few. That change
is divided by diameter^6 / depth^4, with which it varies least.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numpy as np

import geometry
import solver
from geometry.common.arrays import Floats, Ints
from geometry.common.cached_arrays import find_cache_folder, read_arrays, write_arrays
from geometry.common.errors import Refusal
from geometry.common.limits import format_maximum_mm
from geometry.provenance.block import DISTRIBUTION
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from solver.inclusions.tumours import Tumours
from solver.reading_tables.effect_samplers import EffectSampler, choose_sampler
from solver.reading_tables.expansion import OffsetGrid, build_cube_points, evaluate_cube_basis
from solver.reading_tables.layer_table import FINE_STEPS, LayerTable
from solver.reading_tables.reading_table import ReadingTable, combine_effects
from solver.reading_tables.tumour_ranges import TumourCube, TumourRanges, build_cubes, list_ranges

FIRST_COUNTS, FIRST_OFFSETS = (14, 8, 4), 24  # points along depth, diameter, strength, and offset, to first order
REFLECTED_OFFSETS = 10  # points along the offset with reflections
REFLECTED_REACH_OUTER_RADII = 3.0  # outer radii: reflections change effects by below 1e-3 of the largest beyond it
MAX_RANK = 14  # products of eq. RT.2: 8 reach 1e-3 of the effect in narrow ranges
RANK_TOLERANCE_RELATIVE = 1e-4  # of the largest singular value: smaller ones change the measured error by less than a tenth
COEFFICIENT_TOLERANCE_RELATIVE = 1e-5  # of the largest coefficient: polynomials with smaller ones are dropped
END_SHARE = 0.02  # of the largest effect: more of it at the end of the tissue's side is refused
REACH_OUTER_RADII, REACH_DEPTHS = 2.0, 2.5  # the end of the table: beyond it effects are below 1e-3 of the largest
SCALE_OUTER_RADII = 0.6  # outer radii: scale of offsets
TABLE_ARRAYS = (
    "scale",
    "end",
    "offset_functions",
    "degrees",
    "coefficients",
    "error",
    "scale_error",
    "worst_error",
)  # stored on disk
UNLIKE_SHARE = (
    0.3  # of the model's error that each signal has by itself: against tests/reference/contact they differ by 0.1 to 0.3
)
HELD_OUT_TUMOURS, HELD_OUT_SEED = 24, 7  # tumours at which the error is measured
HELD_OUT_OFFSETS_OUTER_RADII = (0.0, 0.35, 0.7, 1.0, 1.4, 2.0, 3.0)  # outer radii: where their readings are compared


def read_or_build_table(scene: Scene, ranges: TumourRanges, sampler: EffectSampler | None = None) -> ReadingTable:
    """Return the table of a scene's probe and tissue from the cache, or build it.

    Parameters
    ----------
    scene
        The scene; its inclusions are not used.
    ranges
        Of the tumours.
    sampler
        Computes the effects; left out, the one of ``choose_sampler``.

    Returns
    -------
    ReadingTable
        The table with its errors measured at tumours that were not used to build it.

    Raises
    ------
    Refusal
        The evaluator cannot model the scene, the ranges do not fit the tissue, or the tissue is so narrow that effects do not
        decay within it.
    """
    sampler = sampler or choose_sampler(scene)
    cubes = build_cubes(ranges, scene.tissue)
    return ReadingTable(scene, ranges, tuple(_read_or_build_layer(scene, cube, sampler) for cube in cubes))


def _read_or_build_layer(scene: Scene, cube: TumourCube, sampler: EffectSampler) -> LayerTable:
    """Return the table of one layer."""
    text = f"{_compute_source_digest()} {version(DISTRIBUTION)} {np.__version__} {sampler.key} {list_ranges(cube.ranges)}"
    path = find_cache_folder("tables") / f"{hashlib.sha256(text.encode()).hexdigest()}.table"
    arrays = read_arrays(path)
    if arrays is None:
        table = _build_layer(scene, cube, sampler)
        write_arrays(path, {name: np.asarray(getattr(table, name)) for name in TABLE_ARRAYS})
        return table
    parts = (arrays[name] for name in TABLE_ARRAYS[2:])
    return LayerTable(cube, float(arrays["scale"]), float(arrays["end"]), *parts)


def _build_layer(scene: Scene, cube: TumourCube, sampler: EffectSampler) -> LayerTable:
    """Build the table of one layer, see ``read_or_build_table``."""
    outer_radius, largest = scene.probe.tube_radius, cube.ranges.diameter[1]
    wanted = REACH_OUTER_RADII * outer_radius + REACH_DEPTHS * cube.compute_bottom(cube.ranges.diameter[0])
    end = min(wanted, sampler.tissue_radius - largest / 2 * 1.001)
    if end <= 0:
        allowed = f"at least {format_mm(largest)}, so that the largest tumour fits"
        raise Refusal("tissue.radius", format_mm(sampler.tissue_radius), allowed)
    scale = SCALE_OUTER_RADII * outer_radius
    grid, counts = OffsetGrid(scale, end, FIRST_OFFSETS), _choose_counts(cube, FIRST_COUNTS)
    values = _sample(sampler, cube, grid.points, build_cube_points(counts), reflect=False)
    values += _interpolate_reflections(sampler, cube, grid, counts)
    _check_decay(values, cube, end, sampler)
    table = _reduce(cube, grid, counts, values)
    error, scale_error, worst_error = _measure_error(table, outer_radius, sampler)
    return replace(table, error=error, scale_error=scale_error, worst_error=worst_error)


def _choose_counts(cube: TumourCube, counts: tuple[int, ...]) -> tuple[int, int, int]:
    """Return the numbers of points, 1 for a quantity with a single value."""
    ranges = (cube.ranges.depth, cube.ranges.diameter, cube.ranges.youngs_modulus)
    singles = [high / low - 1 < 1e-9 for low, high in ranges]
    depth, diameter, strength = (1 if single else count for count, single in zip(counts, singles, strict=True))
    return depth, diameter, strength


def _choose_reflected_counts(cube: TumourCube) -> tuple[int, int, int]:
    """Return the numbers of points with reflections, more for wider ranges."""
    ranges = (cube.ranges.depth, cube.ranges.diameter)
    depth, diameter = (np.log(high / low) for low, high in ranges)
    return _choose_counts(cube, (int(np.ceil(2 + 3 * depth)), int(np.ceil(1.5 + 2.5 * diameter)), 3))


def _sample(sampler: EffectSampler, cube: TumourCube, offsets: Floats, points: Floats, reflect: bool) -> Floats:
    """Return effects per diameter^3 at offsets and points of the cube, 1/m^3, shape (offsets, points, 3)."""
    columns = np.broadcast_arrays(offsets[:, None], 0.0, *cube.map_from_cube(points), cube.ranges.poisson_ratio)
    tumours = Tumours(*(np.ravel(column) for column in columns))
    effects = sampler.compute_effects(tumours, reflect) / tumours.diameter[:, None] ** 3
    return np.asarray(effects.reshape(len(offsets), len(points), 3))


def _interpolate_reflections(sampler: EffectSampler, cube: TumourCube, grid: OffsetGrid, counts: tuple[int, int, int]) -> Floats:
    """Return the changes by reflections at the points of a finer grid, as ``_sample`` does."""
    end = min(grid.end, REFLECTED_REACH_OUTER_RADII / SCALE_OUTER_RADII * grid.scale)
    coarse, coarse_counts = OffsetGrid(grid.scale, end, REFLECTED_OFFSETS), _choose_reflected_counts(cube)
    points, fine_points = build_cube_points(coarse_counts), build_cube_points(counts)
    changes = _sample(sampler, cube, coarse.points, points, True) - _sample(sampler, cube, coarse.points, points, False)
    sizes, fine_sizes = ((diameter**3 / depth**4) for depth, diameter, _ in map(cube.map_from_cube, (points, fine_points)))
    degrees = _list_degrees(coarse_counts)
    matrix = np.linalg.solve(evaluate_cube_basis(points, degrees).T, evaluate_cube_basis(fine_points, degrees).T).T
    between = coarse.build_interpolation(grid.points)
    fine_changes = np.einsum("ao,opc,np->anc", between, changes / sizes[:, None], matrix, optimize=True)
    return np.asarray(fine_changes * fine_sizes[:, None])


def _list_degrees(counts: tuple[int, int, int]) -> Ints:
    """Return the degrees of all products of polynomials, shape (p, 3)."""
    return np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)


def _check_decay(values: Floats, cube: TumourCube, end: float, sampler: EffectSampler) -> None:
    """Raise ``Refusal`` where the effect of a tumour at the table's end is not small, as tissue ends there."""
    sizes = np.abs(values)
    largest = sizes.max(axis=0)
    largest[:, :2] = largest[:, :2].max(axis=1, keepdims=True)  # of both films: the signal is their difference
    share = float((sizes[0] / largest).max())  # the first point is the farthest
    if share > END_SHARE:
        allowed = (
            f"tissue wide enough that a tumour's effect decays within it: at {format_maximum_mm(end)} from the probe it is still "
            f"{share:.0%} of its largest"
        )
        raise Refusal("tissue.radius", format_mm(sampler.tissue_radius), allowed)


def _reduce(cube: TumourCube, grid: OffsetGrid, counts: tuple[int, int, int], values: Floats) -> LayerTable:
    """Return the table without its errors from effects per diameter^3 at the points, shape (offsets, points, 3)."""
    matrix = values.reshape(grid.count, -1)
    sizes = np.abs(values).max(axis=0).ravel()  # weak tumours count as much as strong ones
    left, singular, _ = np.linalg.svd(matrix / sizes, full_matrices=False)
    left = left[:, : min(MAX_RANK, int((singular > RANK_TOLERANCE_RELATIVE * singular[0]).sum()))]
    degrees = _list_degrees(counts)
    basis = evaluate_cube_basis(build_cube_points(counts), degrees)
    weights = np.linalg.solve(basis, (left.T @ matrix).reshape(-1, len(degrees), 3))
    coefficients = weights.transpose(1, 0, 2)
    large = np.abs(coefficients).max(axis=(1, 2)) > COEFFICIENT_TOLERANCE_RELATIVE * np.abs(coefficients).max()
    coordinate = np.linspace(0, np.hypot(2 * grid.end, grid.scale) - grid.scale, FINE_STEPS + 1)
    offsets = np.sqrt(coordinate * (coordinate + 2 * grid.scale))
    functions = grid.build_interpolation(offsets) @ left
    return LayerTable(cube, grid.scale, grid.end, functions, degrees[large], coefficients[large])


def _measure_error(table: LayerTable, outer_radius: float, sampler: EffectSampler) -> tuple[Floats, Floats, Floats]:
    """Return the errors of a table and of its model, and the largest of the table, at tumours drawn evenly within its ranges."""
    random, cube = np.random.default_rng(HELD_OUT_SEED), table.cube
    depth, diameter, modulus = cube.map_from_cube(random.uniform(-1, 1, (HELD_OUT_TUMOURS, 3)))
    depth = np.clip(depth, cube.compute_shallowest(diameter), cube.compute_deepest(diameter))
    offsets = np.minimum(np.array(HELD_OUT_OFFSETS_OUTER_RADII) * outer_radius, table.end)
    columns = np.broadcast_arrays(offsets, 0.0, depth[:, None], diameter[:, None], modulus[:, None], cube.ranges.poisson_ratio)
    tumours = Tumours(*(np.ravel(column) for column in columns))
    effects = sampler.compute_effects(tumours, reflect=True)
    truth = combine_effects(effects).reshape(HELD_OUT_TUMOURS, len(offsets), 2)
    candidates = np.stack([0 * depth, 0 * depth, depth, diameter, modulus], axis=-1)
    predicted, _ = table.compute_effects(candidates, np.stack([offsets, 0 * offsets], axis=-1))
    deviations = np.abs(combine_effects(predicted) - truth)
    squares = np.stack([deviations**2, sampler.compute_errors(tumours).reshape(truth.shape) ** 2])
    error, scale_error = np.sqrt(squares.mean(axis=(1, 2)) / (truth**2).mean(axis=(0, 1)))
    error = np.hypot(error, UNLIKE_SHARE * scale_error)
    return error, scale_error, (deviations.max(axis=1) / np.abs(truth).max(axis=1)).max(axis=0)


@cache
def _compute_source_digest() -> str:
    """Return the digest of the sources on which the effects depend, read once per process."""
    digest = hashlib.sha256()
    for package in (geometry, solver):
        for path in sorted(Path(str(package.__file__)).parent.rglob("*.py")):
            digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
