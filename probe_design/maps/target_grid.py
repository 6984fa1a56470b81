"""Build spheres of many sizes at many depths in the place of a scene's target, and determine which of them fit."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import InputError, Refusal, Words
from geometry.common.limits import format_minimum_mm
from geometry.scenes.probe import format_mm
from geometry.scenes.quantities import LENGTH_QUANTITY
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion
from geometry.scenes.tissue_sides import compute_side_distance
from solver.inclusions.tumours import Tumours

MIN_COVER_FRACTION = 0.025  # of the diameter: thinnest tissue between a sphere and a face for which the evaluator is accurate
MAX_FILL_FRACTION = 1 - 1e-9  # of the free distance: largest radius of a sphere
DEPTH_RANGE_RADII, DIAMETER_RANGE_RADII = 4.0, 2.5  # outer radii: ranges unless the scene's tumour needs more
SCENE_SIZE_FACTOR = 1.5  # times the scene's depth and diameter: smallest ranges
RANGE_DIVISOR = 50  # largest over smallest depth and diameter


@dataclass(frozen=True)
class Spheres:
    """A grid of depths and diameters.

    Attributes
    ----------
    scene
        Its target is replaced; material and lateral offset are kept.
    depth, diameter
        m, shapes (k,) and (m,).
    radius
        Radius of the modelled cylinder of tissue about the probe's axis, m.

    Raises
    ------
    InputError
        A size is not positive, or there is no target.
    """

    scene: Scene
    depth: Floats
    diameter: Floats
    radius: float

    def __post_init__(self) -> None:
        """Check the sizes."""
        for key in ("depth", "diameter"):
            values = getattr(self, key)
            if values.ndim != 1 or not values.size or not np.all(np.isfinite(values) & (values > 0)):
                raise InputError(key, "not all positive", "one or more positive finite lengths, m")

    @cached_property
    def fits(self) -> Bools:
        """Whether each sphere lies within one layer, under enough overburden, and apart from other inclusions; shape (k, m)."""
        body, placement, depth = find_target(self.scene), self.scene.placement, self.depth
        side_distance = self.radius - np.hypot(body.x - placement.x, body.y - placement.y)
        free_radius = np.minimum(compute_free_radii(self.scene, depth), side_distance)
        radius, face_distances = (
            self.diameter / 2,
            [np.abs(depth - interface) for interface in (0.0, *self.scene.tissue.interfaces)],
        )
        # cover: thinnest tissue between the sphere and the surface or an interface
        cover = np.min(face_distances, axis=0)[:, None] - radius
        return np.asarray((radius < free_radius[:, None] * MAX_FILL_FRACTION) & (cover >= MIN_COVER_FRACTION * self.diameter))

    @property
    def tumours(self) -> Tumours:
        """The inclusions of the scene, with each sphere that fits in the target's place, shape (fits.sum(), inclusions)."""
        row, column = np.nonzero(self.fits)
        scene_tumours, target = Tumours.from_scene(self.scene), self.scene.target
        table = {field.name: np.repeat(getattr(scene_tumours, field.name), len(row), axis=0) for field in fields(scene_tumours)}
        table["depth"][:, target], table["diameter"][:, target] = self.depth[row], self.diameter[column]
        return Tumours(**table)

    @property
    def other_tumours(self) -> Tumours:
        """The inclusions of the scene without the target, shape (1, inclusions - 1)."""
        keep = [index for index in range(len(self.scene.inclusion)) if index != self.scene.target]
        return Tumours.from_scene(self.scene).select((slice(None), keep))


def check_spheres(scene: Scene, command: str) -> None:
    """Raise ``Refusal`` where an inclusion is no sphere; ``command`` is named in the message."""
    for index, body in enumerate(scene.inclusion):
        if body.diameter is None:
            shape = Words("diameters" if body.diameters is not None else "surface")
            allowed = f"a diameter, as {command} is built for spheres so far (evaluate takes ellipsoids)"
            raise Refusal(f"inclusion[{index}]", shape, allowed)


def compute_free_radii(scene: Scene, depth: Floats) -> Floats:
    """Return the radius of the largest sphere in the target's place at each of n depths, m, shape (n,).

    It is the distance of the target's centre from surface, sides, bottom or another inclusion, whichever is nearest; interfaces
    between layers do not count.
    """
    body, tissue = find_target(scene), scene.tissue
    radius = np.minimum(np.minimum(depth, tissue.bottom - depth), compute_side_distance(tissue, body.x, body.y))
    for index, neighbour in enumerate(scene.inclusion):
        if index != scene.target:
            distance = np.sqrt((neighbour.x - body.x) ** 2 + (neighbour.y - body.y) ** 2 + (neighbour.depth - depth) ** 2)
            radius = np.minimum(radius, distance - (neighbour.diameter or 0.0) / 2)
    return np.asarray(radius)


def find_target(scene: Scene) -> Inclusion:
    """Return the target inclusion.

    Raises
    ------
    InputError
        There is no inclusion, or none of several is marked as the target.
    """
    if not scene.inclusion:
        raise InputError("inclusion", Words("none"), "at least one inclusion, whose material the map is for")
    if scene.target is None:
        raise InputError("inclusion.target", Words("none of several"), "target = true in the inclusion that the map is for")
    return scene.inclusion[scene.target]


def choose_sizes(
    scene: Scene, points: int, *, depth_from: float | None = None, depth_to: float | None = None,
    diameter_from: float | None = None, diameter_to: float | None = None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Return evenly spaced depths and diameters, m, ``points`` of each, between given ends or ends chosen from the scene.

    Raises
    ------
    InputError
        An upper end is not above the lower one, or there is no target.
    """
    body, reach = find_target(scene), scene.probe.tube_radius
    max_length = min(LENGTH_QUANTITY.high, scene.tissue.bottom)
    max_depth = min(max_length, max(DEPTH_RANGE_RADII * reach, SCENE_SIZE_FACTOR * body.depth))
    max_diameter = min(max_length, max(DIAMETER_RANGE_RADII * reach, SCENE_SIZE_FACTOR * (body.diameter or 0.0)))
    depths = _space_sizes("depth", depth_from, depth_to, max_depth, points)
    return depths, _space_sizes("diameter", diameter_from, diameter_to, max_diameter, points)


def _space_sizes(key: str, low: float | None, high: float | None, default_last: float, points: int) -> Floats:
    """Return evenly spaced sizes, m.

    A missing upper end is ``default_last``, or twice the lower end if that is larger. A missing lower end is a fixed fraction
    of the upper end.
    """
    last = max(default_last, 2 * (low or 0.0)) if high is None else high
    first = last / RANGE_DIVISOR if low is None else low
    if not first < last:
        raise InputError(f"{key}-to", format_mm(last), f"above {key}-from = {format_minimum_mm(first)}")
    return np.linspace(first, last, points)
