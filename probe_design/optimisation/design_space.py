"""The design space: six variables of the probe, their bounds and what a workshop can make."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from geometry.scenes.probe import mm
from geometry.scenes.scene import Scene

VARIABLES = ("inner_radius", "area_ratio", "gap", "height", "inner_modulus", "outer_modulus")
LEAST_GAP, LARGEST_GAP = 0.1e-3, 0.5e-3  # m: the paper found wider gaps "less robust"
LEAST_WALL = 0.5e-3  # m: thinner sleeves of elastomer are not handled well
MODULI = (10e3, 1e6)  # Pa: soft silicone gel to rubber a tenth as stiff as the paper's base, which counts as rigid
DIGITS = 3  # of moduli; lengths are rounded to 0.01 mm


@dataclass(frozen=True)
class Space:
    """Bounds of the variables, SI, and the constraints that join them.

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

    def derived_radius(self, x: Any) -> Any:
        """Outer radius of designs x (variables first), from A2/A1."""
        return ((x[0] + x[2]) ** 2 + x[0] ** 2 / x[1]) ** 0.5

    def admits(self, x: Floats) -> NDArray[np.bool_]:
        """Which designs, shape (6, n), meet the constraints."""
        radius = self.derived_radius(x)
        return np.asarray((radius <= self.outer_radius) & (radius - x[0] - x[2] >= self.wall))

    def scene_of(self, x: Floats) -> Scene | None:
        """Return the scene with the design x rounded to what is ordered from a workshop; None where rounding breaks a rule."""
        length = [round(float(v), 5) for v in (x[0], x[2], x[3])]
        outer = math.floor(float(self.derived_radius(x)) * 1e5 + 1e-6) / 1e5
        moduli = [float(f"{v:.{DIGITS}g}") for v in x[4:]]
        probe = self.scene.probe.model_dump(exclude={"area_ratio", "inner_height", "outer_height"}, exclude_unset=True)
        probe |= {"inner_radius": length[0], "gap": length[1], "height": length[2], "outer_radius": outer}
        for block, modulus in zip(("inner", "outer"), moduli, strict=True):
            probe[block]["youngs_modulus"] = modulus
        try:
            return Scene.model_validate(self.scene.model_dump(exclude_unset=True) | {"probe": probe})
        except ValueError:
            return None


def space(scene: Scene, outer_radius: float | None = None) -> Space:
    """Return the design space round a scene's probe; the limit of the outer radius is 1.4 times the start's unless given.

    Raises:
        InputError: the limit leaves no room for a probe, or for the probe on the tissue.
    """
    probe, tissue = scene.probe, scene.tissue
    limit = 1.4 * probe.tube_radius if outer_radius is None else outer_radius
    room = math.inf if tissue.shape == "half-space" else tissue.radius if tissue.shape == "cylinder" else tissue.breadth / 2
    limit = min(limit, 0.95 * room)
    gap = (min(LEAST_GAP, probe.gap), max(LARGEST_GAP, probe.gap))
    wall = min(LEAST_WALL, probe.tube_radius - probe.hole_radius, 0.1 * limit)
    groove = probe.groove
    narrowest = max(0.1 * limit, 0.0 if groove is None else 0.55 * groove.width)
    flattest = max(0.2 * limit, 0.0 if groove is None else 1.25 * groove.depth)
    widest = limit - gap[0] - wall
    if widest <= narrowest:
        least = narrowest + gap[0] + wall
        raise InputError("outer-radius", mm(limit), f"above {mm(least)}: inner block, gap and wall need as much")
    moduli = [(min(MODULI[0], E), max(MODULI[1], E)) for E in (probe.inner.youngs_modulus, probe.outer.youngs_modulus)]
    bounds = [(narrowest, widest), (0.05, 20.0), gap, (flattest, max(1.5 * limit, flattest)), *moduli]
    low, high = np.array(bounds).T
    return Space(scene, low, high, limit, wall)
