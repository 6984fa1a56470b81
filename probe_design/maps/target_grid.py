"""Build spheres of many sizes at many depths in the place of a scene's target, and determine which of them fit."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import InputError, Refusal, Words
from geometry.common.limits import least_mm
from geometry.scenes.probe import LENGTH, mm
from geometry.scenes.scene import Inclusion, Scene
from solver.inclusions.tumours import Tumours

COVER = 0.025  # of the diameter: thinnest tissue between a sphere and a face for which the evaluator is accurate
CLEAR = 1 - 1e-9  # of the free distance: largest radius of a sphere
DEEP, WIDE = 4.0, 2.5  # outer radii: ranges of depth and diameter unless the scene's tumour needs more
OWN = 1.5  # times the scene's depth and diameter: smallest ranges
LINES = 50  # largest over smallest depth and diameter


@dataclass(frozen=True)
class Spheres:
    """A grid of depths and diameters.

    Attributes:
        scene: its target is replaced; material and lateral offset are kept.
        depth, diameter: m, shapes (k,) and (m,).
        radius: of the modelled cylinder of tissue about the probe's axis, m.

    Raises:
        InputError: a size is not positive, or there is no target.
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
        """Whether each sphere lies within one layer, below enough tissue, and apart from other inclusions; shape (k, m)."""
        body, tissue, at, depth = target_of(self.scene), self.scene.tissue, self.scene.placement, self.depth
        beside = self.radius - np.hypot(body.x - at.x, body.y - at.y)
        if tissue.shape == "cylinder":
            beside = min(beside, tissue.radius - np.hypot(body.x, body.y))
        elif tissue.shape == "block":
            beside = min(beside, tissue.length / 2 - abs(body.x), tissue.breadth / 2 - abs(body.y))
        free = np.minimum(depth, beside)
        if tissue.shape != "half-space":
            free = np.minimum(free, tissue.depth - depth)
        for other in others(self.scene):
            apart = np.sqrt((other.x - body.x) ** 2 + (other.y - body.y) ** 2 + (other.depth - depth) ** 2)
            free = np.minimum(free, apart - (other.diameter or 0.0) / 2)
        radius, covered = self.diameter / 2, [np.abs(depth - interface) for interface in (0.0, *tissue.interfaces)]
        cover = np.min(covered, axis=0)[:, None] - radius
        return np.asarray((radius < free[:, None] * CLEAR) & (cover >= COVER * self.diameter))

    @property
    def tumours(self) -> Tumours:
        """The inclusions of the scene with those that fit in the target's place, shape (fits.sum(), inclusions)."""
        row, column = np.nonzero(self.fits)
        now, target = Tumours.of(self.scene), self.scene.target
        table = {field.name: np.repeat(getattr(now, field.name), len(row), axis=0) for field in fields(now)}
        table["depth"][:, target], table["diameter"][:, target] = self.depth[row], self.diameter[column]
        return Tumours(**table)

    @property
    def without(self) -> Tumours:
        """The inclusions of the scene without the target, shape (1, inclusions - 1)."""
        keep = [index for index in range(len(self.scene.inclusion)) if index != self.scene.target]
        return Tumours.of(self.scene).of_index((slice(None), keep))


def check_spheres(scene: Scene, verb: str) -> None:
    """Raise ``Refusal`` where an inclusion is no sphere; ``command`` is named in the message."""
    for index, body in enumerate(scene.inclusion):
        if body.diameter is None:
            shape = Words("diameters" if body.diameters is not None else "surface")
            raise Refusal(
                f"inclusion[{index}]", shape, f"a diameter, as {verb} is built for spheres so far (evaluate takes ellipsoids)"
            )


def others(scene: Scene) -> list[Inclusion]:
    """Return all inclusions but the target."""
    return [body for index, body in enumerate(scene.inclusion) if index != scene.target]


def target_of(scene: Scene) -> Inclusion:
    """Return the target inclusion.

    Raises:
        InputError: there is no inclusion, or none of several is marked as the target.
    """
    if not scene.inclusion:
        raise InputError("inclusion", Words("none"), "at least one inclusion, whose material the map is for")
    if scene.target is None:
        raise InputError("inclusion.target", Words("none of several"), "target = true in the inclusion that the map is for")
    return scene.inclusion[scene.target]


def chosen_sizes(
    scene: Scene, points: int, *, depth_from: float | None = None, depth_to: float | None = None,
    diameter_from: float | None = None, diameter_to: float | None = None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Return evenly spaced depths and diameters, m, between given ends, or between ends chosen from probe and target.

    Raises:
        InputError: an end is not above the other; no target.
    """
    body, reach = target_of(scene), scene.probe.tube_radius
    floor = LENGTH.high if scene.tissue.shape == "half-space" else scene.tissue.depth
    deepest = min(floor, max(DEEP * reach, OWN * body.depth))
    widest = min(floor, max(WIDE * reach, OWN * (body.diameter or 0.0)))
    depths = _between("depth", depth_from, depth_to, deepest, points)
    return depths, _between("diameter", diameter_from, diameter_to, widest, points)


def _between(key: str, low: float | None, high: float | None, usual: float, points: int) -> Floats:
    """Return evenly spaced sizes, m; missing ends are chosen from the default of the upper one."""
    last = max(usual, 2 * (low or 0.0)) if high is None else high
    first = last / LINES if low is None else low
    if not first < last:
        raise InputError(f"{key}-to", mm(last), f"above {key}-from = {least_mm(first)}")
    return np.linspace(first, last, points)
