"""The design space: six variables of the probe, their bounds and what a workshop can make."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from geometry.scenes.catalogue import set_number
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.units import SI_CONTEXT

VARIABLES = ("inner_radius", "area_ratio", "gap", "height", "inner_modulus", "outer_modulus")
MIN_RADIUS_M = 0.5e-3  # m: thinner cylinders of elastomer, and thinner sleeves, are not handled well
MIN_WALL_M = 0.5e-3  # m
AREA_RATIO_BOUNDS = (0.05, 20.0)
GAP_BOUNDS_M = (0.1e-3, 0.5e-3)  # m: narrower ones fill with glue, the paper found wider ones "less robust"
HEIGHT_BOUNDS_M = (1e-3, 20e-3)  # m: the thinnest sheet that is cut, the tallest block that stands
MODULUS_BOUNDS_PA = (10e3, 1e6)  # Pa: soft silicone gel to rubber a tenth as stiff as the paper's base, which counts as rigid
DEFAULT_RADIUS_FACTOR = 1.4  # times the start's outer radius: its limit unless one is given
MODULUS_DIGITS = 3  # of moduli; lengths are rounded to 0.01 mm
SAME_DESIGN_TOLERANCE_RELATIVE = 0.005  # relative: designs that differ less are one, and a limit this near is active


@dataclass(frozen=True)
class Limit:
    """One limit of the designs.

    Attributes:
        name: of what, such as ``least gap``.
        value: SI.
        active: whether the design in question lies on it.
    """

    name: str
    value: float
    active: bool


@dataclass(frozen=True)
class Space:
    """Bounds of the variables, SI, and the constraints that join them.

    Each follows from the start and from what a workshop can make, none from another: a tighter limit takes designs away, and no
    other ones come instead.

    Attributes:
        scene: the scene whose probe is varied; everything else in it stays.
        low, high: bounds in the order of ``VARIABLES``, shape (6,).
        outer_radius: limit of the outer block's radius, m.
        wall: least thickness of the outer block, m.
    """

    scene: Scene
    low: Floats
    high: Floats
    outer_radius: float
    wall: float

    def compute_outer_radius(self, x: Any) -> Any:
        """Outer radius of designs x (variables first), from A2/A1."""
        return ((x[0] + x[2]) ** 2 + x[0] ** 2 / x[1]) ** 0.5

    def admits(self, x: Floats) -> NDArray[np.bool_]:
        """Return which designs x, shape (6, n), meet the constraints of outer radius and wall."""
        radius = self.compute_outer_radius(x)
        return np.asarray((radius <= self.outer_radius) & (radius - x[0] - x[2] >= self.wall))

    def build_scene(self, x: Floats) -> Scene | None:
        """Return the scene with the design x rounded to what is ordered from a workshop; None where rounding breaks a rule."""
        outer, (gap, height) = _round_length_down(float(self.compute_outer_radius(x))), (round(float(v), 5) for v in x[2:4])
        inner = min(
            round(float(x[0]), 5), _round_length_down(outer - gap - self.wall)
        )  # or rounding would thin a wall of the least thickness
        moduli = [_round_modulus(v) for v in x[4:]]
        probe = self.scene.probe.model_dump(exclude={"area_ratio", "inner_height", "outer_height"}, exclude_unset=True)
        probe |= {"inner_radius": inner, "gap": gap, "height": height, "outer_radius": outer}
        for block, modulus in zip(("inner", "outer"), moduli, strict=True):
            if modulus != _round_modulus(probe[block]["youngs_modulus"]):  # the start's own stays as it is, and so does its name
                set_number(probe[block], "youngs_modulus", modulus)
        try:
            return Scene.model_validate(self.scene.model_dump(exclude_unset=True) | {"probe": probe}, context=SI_CONTEXT)
        except ValueError:
            return None

    def list_limits(self, scene: Scene) -> tuple[Limit, ...]:
        """Return all limits, and which of them a scene's probe lies on."""
        probe, vector = scene.probe, read_variables(scene)
        rows = [
            ("largest outer_radius", self.outer_radius, probe.tube_radius),
            ("least wall", self.wall, probe.tube_radius - probe.hole_radius),
            ("least inner_radius", self.low[0], vector[0]),
        ]
        for k, name in list(enumerate(VARIABLES))[1:]:
            rows += [(f"least {name}", self.low[k], vector[k]), (f"largest {name}", self.high[k], vector[k])]
        return tuple(
            Limit(name, float(limit), bool(abs(value - limit) <= SAME_DESIGN_TOLERANCE_RELATIVE * limit))
            for name, limit, value in rows
        )


def _round_modulus(modulus: float) -> float:
    """The modulus to ``MODULUS_DIGITS`` figures."""
    return float(f"{modulus:.{MODULUS_DIGITS}g}")


def _round_length_down(length: float) -> float:
    """The next shorter length in steps of 0.01 mm."""
    return math.floor(length * 1e5 + 1e-6) / 1e5


def read_variables(scene: Scene) -> Floats:
    """Return the design of a scene's probe in the order of ``VARIABLES``, SI, shape (6,)."""
    probe = scene.probe
    sizes = [probe.inner_radius, probe.inner_area / probe.outer_area, probe.gap, probe.core_height]
    return np.array([*sizes, probe.inner.youngs_modulus, probe.outer.youngs_modulus])


def is_same_design(first: Scene, second: Scene) -> bool:
    """Return whether two scenes' probes agree in every variable within the relative tolerance."""
    return bool(np.all(np.abs(np.log(read_variables(first) / read_variables(second))) <= SAME_DESIGN_TOLERANCE_RELATIVE))


def build_space(scene: Scene, outer_radius: float | None = None) -> Space:
    """Return the design space round a scene's probe; the limit of the outer radius is 1.4 times the start's unless given.

    Where the start lies beyond a limit other than that, the limit is where the start lies.

    Raises:
        InputError: the limit leaves no room for a probe, or for the probe on the tissue.
    """
    probe, tissue = scene.probe, scene.tissue
    limit = DEFAULT_RADIUS_FACTOR * probe.tube_radius if outer_radius is None else outer_radius
    design_space = (
        math.inf if tissue.shape == "half-space" else tissue.radius if tissue.shape == "cylinder" else tissue.breadth / 2
    )
    limit = min(limit, 0.95 * design_space)
    start, groove = read_variables(scene), probe.groove
    bounds = [(MIN_RADIUS_M, math.inf), AREA_RATIO_BOUNDS, GAP_BOUNDS_M, HEIGHT_BOUNDS_M, MODULUS_BOUNDS_PA, MODULUS_BOUNDS_PA]
    low, high = (
        np.array([pick(bound[k], value) for bound, value in zip(bounds, start, strict=True)]) for k, pick in enumerate((min, max))
    )
    if groove is not None:
        low[0], low[3] = max(low[0], 0.55 * groove.width), max(low[3], 1.25 * groove.depth)
    wall = min(MIN_WALL_M, probe.tube_radius - probe.hole_radius)
    high[0] = limit - low[2] - wall
    if high[0] <= low[0]:
        min_radius = low[0] + low[2] + wall
        raise InputError(
            "outer-radius", format_mm(limit), f"above {format_mm(min_radius)}: inner block, gap and wall need as much"
        )
    return Space(scene, low, high, limit, wall)
