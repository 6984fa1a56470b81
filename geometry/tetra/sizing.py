"""Compute the wanted size of tetrahedra by position, as a field on a background mesh of the volume mesher's space."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points
from geometry.tetra.body_layout import BodyLayout
from geometry.tetra.stretched_space import MeshSpace, choose_mesh_space
from geometry.tetra.surface_files import Sheet

_KUHN_TETRAHEDRA = np.array([(0, 1, 3, 7), (0, 1, 5, 7), (0, 2, 3, 7), (0, 2, 6, 7), (0, 4, 5, 7), (0, 4, 6, 7)])  # a cube's six
_THIN_WALL_FACTOR = 4.5  # tubes with walls thinner than the solid cylinder's radius over this have finer rims
_INCLUSION_GROWTH_FACTOR = 1.6  # how much faster tetrahedra become larger round inclusions than round the probe
_FAR_GROWTH = 0.7  # relative increase of far sizes with each e-fold of distance, in addition to ``growth``
_FAR_INCLUSION_POWER = 0.3  # power of that factor by which sizes in inclusions increase
_FLAT_SIZE_FRACTION = 0.5  # of the sizes in blocks, or at inclusions: what is thinner makes tetrahedra flatter, not smaller
_MAX_LAYER_ASPECT_RATIO = 5.0  # thicknesses of a layer that tetrahedra cut by its planes are long, however far they are
_ANGLE_SAMPLES, _RADIUS_SAMPLES = 48, 120  # places on a plane between layers where sizes are requested
_LINEAR_RADIUS_FACTOR = 1.7  # far tissue begins at this many times the probe's largest length
_MAX_GAP_WIDENING = 12  # the gap becomes wider by this factor at most: tetrahedra below it are squeezed as much on the way back
_OUTSIDE_SIZE_FACTOR = 3.0  # how much larger tetrahedra may be outside
_OUTSIDE_DISTANCE_FACTOR = 1.1  # times the tissue's size: from where on points count as outside


@dataclass(frozen=True)
class TetraFineness:
    """Sizes of tetrahedra relative to the bodies', and how they grow.

    Attributes
    ----------
    groove
        At the groove, over its width or depth, whichever is less.
    rim
        At the gap's rims, over the solid cylinder's radius.
    block
        In the blocks, over that radius.
    wall
        In the tube's wall and along the blocks' heights, over these.
    sphere
        At inclusions, over their smallest radius.
    layer
        Between inclusion and surface or interface, over their distance, and in layers of tissue, over their thickness.
    growth
        With the distance from all these.
    """

    groove: float
    rim: float
    block: float
    wall: float
    sphere: float
    layer: float
    growth: float


ROUGHEST_FINENESS = TetraFineness(groove=1.3, rim=0.19, block=0.6, wall=1.7, sphere=0.6, layer=1.2, growth=0.55)
ROUGH_FINENESS = TetraFineness(groove=1.0, rim=0.14, block=0.45, wall=1.3, sphere=0.45, layer=0.9, growth=0.42)
COARSE_FINENESS = TetraFineness(groove=0.65, rim=0.1, block=0.33, wall=0.95, sphere=0.333, layer=0.65, growth=0.32)
FINE_FINENESS = TetraFineness(groove=0.4, rim=0.072, block=0.24, wall=0.65, sphere=0.222, layer=0.45, growth=0.235)


def choose_space(layout: BodyLayout, fineness: TetraFineness) -> MeshSpace:
    """Choose the mesher's space: a gap as wide as tetrahedra at its rims, and tissue beyond probe and files drawn near."""
    height = max(layout.inner_height, layout.outer_height)
    sheets = [float(np.linalg.norm(body.points, axis=1).max()) for body in layout.inclusions if isinstance(body, Sheet)]
    return choose_mesh_space(
        layout.inner,
        layout.hole,
        layout.tube,
        gap=min(fineness.rim * layout.inner, _MAX_GAP_WIDENING * layout.gap),
        linear_radius=max(_LINEAR_RADIUS_FACTOR * max(layout.tube, height), *(1.05 * size for size in sheets), 0.0),
        height=height,
        rise=fineness.growth * height,  # the gap becomes wider upwards as fast as the tetrahedra become larger
    )


def compute_sizes(layout: BodyLayout, fine: TetraFineness, space: MeshSpace, points: Points) -> Points:
    """Return the wanted edge lengths in m at points (n, 3) of the scene, (n,).

    Each feature asks for a size on it, which grows linearly with the distance from it; the smallest wins. ``fine`` are the sizes
    relative to the features, ``space`` says how much far tissue is drawn near, where tetrahedra may be larger.
    """
    radius, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    rims = np.full(len(points), np.inf)
    thickness = min(layout.tube - layout.hole, layout.inner)
    for rim, size in (  # radii of the gap's and of the tube's rim on the tissue, and the sizes there
        ((layout.inner + layout.hole) / 2, fine.rim * min(layout.inner, _THIN_WALL_FACTOR * thickness)),
        (layout.tube, fine.rim * min(2 * layout.inner, _THIN_WALL_FACTOR * thickness)),
    ):
        # the gap's two rims are one circle in its middle, less a gap's width
        distance = np.maximum(np.hypot(radius - rim, z) - (layout.gap if rim < layout.hole else 0.0), 0.0)
        rims = np.minimum(rims, size + fine.growth * distance)
    block_distance = _compute_block_distances(layout, radius, z)
    result: Points = np.minimum(rims, fine.block * layout.inner + fine.growth * block_distance)
    # along the blocks' heights, and across the tube's wall
    heights = fine.wall * min(layout.inner_height, layout.outer_height)
    walls = np.minimum(heights, fine.wall * thickness + fine.growth * np.maximum(layout.hole - radius, 0.0))
    result = np.minimum(result, walls + fine.growth * block_distance)
    if layout.groove is not None:
        width, depth = layout.groove
        # distance from the groove: to its sides and towards -x, below its floor, and inwards of the hole
        sideways = np.maximum(np.abs(points[:, 1]) - width, 0) + np.maximum(-points[:, 0], 0)
        distance = np.hypot(sideways, np.maximum(layout.outer_height - depth - z, 0)) + np.maximum(layout.hole - radius, 0)
        result = np.minimum(result, fine.groove * min(2 * width, depth) + fine.growth * (distance + block_distance))
    layers = list(pairwise((0.0, *layout.interfaces)))
    for top, bottom in layers:  # depths of a layer's upper and lower plane
        # under the blocks; thinner layers than the lower limit make flat tetrahedra
        layer_size = max(fine.layer * (bottom - top), _FLAT_SIZE_FRACTION * fine.block * layout.inner)
        result = np.minimum(result, layer_size + fine.growth * (_compute_layer_distances(top, bottom, z) + block_distance))
    far_factor = 1 - _FAR_GROWTH * np.log(space.compute_scale(points))
    for body in layout.inclusions:
        # between an inclusion and the surface, then each interface: the sum of both distances is smallest between them
        layer = fine.layer * (np.abs(body.estimate_distance(points)) + np.abs(z))
        for depth in layout.interfaces:
            interface_size = fine.layer * (np.abs(body.estimate_distance(points)) + np.abs(z + depth))
            layer = np.minimum(layer, np.maximum(interface_size, _FLAT_SIZE_FRACTION * fine.sphere * body.min_semi_axis))
        result = np.minimum(result, layer + fine.growth * block_distance)
    result *= far_factor  # far from the probe, where fields change slowly, sizes may be larger
    for body in layout.inclusions:
        inclusion_size, growth = (
            fine.sphere * body.min_semi_axis * far_factor**_FAR_INCLUSION_POWER,
            _INCLUSION_GROWTH_FACTOR * fine.growth * far_factor,
        )
        result = np.minimum(result, inclusion_size + growth * np.abs(body.estimate_distance(points)))
    for top, bottom in layers:
        result = np.minimum(
            result, _MAX_LAYER_ASPECT_RATIO * (bottom - top) + fine.growth * far_factor * _compute_layer_distances(top, bottom, z)
        )
    return result


def _compute_layer_distances(top: float, bottom: float, z: Points) -> Points:
    """Return the distances (n,) of heights z from the layer between the depths ``top`` and ``bottom``."""
    return np.maximum(np.maximum(top + z, -z - bottom), 0.0)


def count_squares(layout: BodyLayout, fine: TetraFineness, space: MeshSpace) -> float:
    """Return how many squares of the wanted edge length cover the planes between layers; of a half mesh, their halves.

    The integral of 1 / size^2 over the planes, by samples at some angles and at radii that are dense near the probe.
    """
    angles: Points = np.arange(_ANGLE_SAMPLES, dtype=np.float64) * (2 * np.pi / _ANGLE_SAMPLES)
    steps = np.geomspace(1e-3, 1.0, _RADIUS_SAMPLES)
    shares, widths = np.sqrt(steps[1:] * steps[:-1]), np.diff(steps)
    side_vectors = np.column_stack([np.cos(angles), np.sin(angles)]) * layout.compute_side_distance(angles)[:, None]
    flat, area = side_vectors[:, None] * shares[:, None], np.linalg.norm(side_vectors, axis=1)[:, None] ** 2 * shares * widths
    total = 0.0
    for depth in layout.interfaces:
        points = np.column_stack([flat.reshape(-1, 2), np.full(flat[..., 0].size, -depth)])
        total += float((area.ravel() * (2 * np.pi / _ANGLE_SAMPLES) / compute_sizes(layout, fine, space, points) ** 2).sum())
    return total / 2 if layout.half else total


def _compute_block_distances(layout: BodyLayout, radius: Points, z: Points) -> Points:
    """Return the distances (n,) of points at radii and heights z (n,) from the probe's blocks, a cylinder on the surface."""
    return np.hypot(np.maximum(radius - layout.tube, 0), np.maximum(-z, 0))


def build_background(
    layout: BodyLayout, fine: TetraFineness, space: MeshSpace, box: Points
) -> tuple[Points, NDArray[np.int32], Points]:
    """Build a mesh of a box in the mesher's space, on which pytetwild interpolates the wanted edge lengths.

    ``box`` (2, 3) has its lower and its upper corner. Return points (n, 3), tetrahedra (t, 4) and an edge length at each point.
    """
    min_size = fine.rim * layout.inner
    axes = [_grade_axis(low, high, min_size, space.linear_radius) for low, high in box.T]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    scene = space.to_scene(grid)
    values = compute_sizes(layout, fine, space, scene) * space.compute_scale(scene)
    values[_is_outside(layout, scene)] *= _OUTSIDE_SIZE_FACTOR
    counts = [len(axis) for axis in axes]
    number = np.arange(len(grid)).reshape(counts)
    a, b, c = (count - 1 for count in counts)
    cube = [number[i : a + i, j : b + j, k : c + k].ravel() for i, j, k in np.ndindex(2, 2, 2)]
    tetrahedra = np.stack(cube, axis=1)[:, _KUHN_TETRAHEDRA].reshape(-1, 4)
    return grid, tetrahedra.astype(np.int32), values


def _is_outside(layout: BodyLayout, points: Points) -> NDArray[np.bool_]:
    """Return which points (n, 3) lie well outside all bodies, where the mesh is discarded."""
    radius, z, margin = np.hypot(points[:, 0], points[:, 1]), points[:, 2], 0.2 * layout.tube
    is_above = (z > margin) & ((radius > layout.tube + margin) | (z > max(layout.inner_height, layout.outer_height) + margin))
    side = layout.compute_side_distance(np.arctan2(points[:, 1], points[:, 0]))
    is_beside = (radius > _OUTSIDE_DISTANCE_FACTOR * side) | (z < -_OUTSIDE_DISTANCE_FACTOR * layout.depth)
    return is_above | is_beside | ((points[:, 1] < -margin) if layout.half else False)


def _grade_axis(low: float, high: float, min_size: float, linear_radius: float) -> Points:
    """Return the points of an axis from low to high, about ``min_size`` apart near zero and further apart away from it."""
    # points equally spaced in asinh(x / scale), with a scale of a third of ``linear_radius``
    ends = np.arcsinh(np.array([low, high]) / (linear_radius / 3))
    count = int(np.clip(np.ptp(ends) * linear_radius / 3 / min_size, 12, 48))
    return np.asarray(np.sinh(np.linspace(ends[0], ends[1], count + 1)) * linear_radius / 3)
