"""Define the numbers of a probe that a search varies, with their limits, and convert scenes to vectors and back.

Only ``VARIABLES`` lists them. A design is a vector x of their values in the order of ``VariableSpace.names``, with one height of
both blocks, or with a height of each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Floats, Numeric
from geometry.common.errors import InputError
from geometry.scenes.catalogue import set_number
from geometry.scenes.probe import LENGTH_QUANTITY, Probe, format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.units import MODULUS_QUANTITY, SI_CONTEXT
from geometry.scenes.variables import BLOCK_NAMES

MIN_RADIUS_M = 0.5e-3  # m: thinner cylinders of elastomer, and thinner sleeves, are not handled well
MIN_WALL_M = 0.5e-3  # m
GAP_BOUNDS_M = (0.1e-3, 0.5e-3)  # m: narrower ones fill with glue, the paper found wider ones "less robust"
HEIGHT_BOUNDS_M = (1e-3, 20e-3)  # m: the thinnest sheet that is cut, the tallest block that stands
MODULUS_BOUNDS_PA = (10e3, 1e6)  # Pa: soft silicone gel to rubber a tenth as stiff as the paper's base, which counts as rigid


@dataclass(frozen=True)
class Variable:
    """One number of the probe that a search varies.

    Attributes
    ----------
    key
        Key of ``geometry.scenes.variables.list_values``.
    low, high
        Smallest and largest value that a workshop can make, SI.
    """

    key: str
    low: float
    high: float


VARIABLES = {
    "inner_radius": Variable("probe.inner_radius", MIN_RADIUS_M, math.inf),
    "area_ratio": Variable("probe.area_ratio", 0.05, 20.0),
    "gap": Variable("probe.gap", *GAP_BOUNDS_M),
    "height": Variable("probe.height", *HEIGHT_BOUNDS_M),
    "inner_height": Variable("probe.inner_height", *HEIGHT_BOUNDS_M),
    "inner_modulus": Variable("probe.inner.youngs_modulus", *MODULUS_BOUNDS_PA),
    "outer_modulus": Variable("probe.outer.youngs_modulus", *MODULUS_BOUNDS_PA),
    "outer_height": Variable("probe.outer_height", *HEIGHT_BOUNDS_M),
}
SHARED_HEIGHT_NAMES = tuple(name for name in VARIABLES if name not in ("inner_height", "outer_height"))
SEPARATE_HEIGHT_NAMES = tuple(name for name in VARIABLES if name != "height")
MODULUS_NAMES = ("inner_modulus", "outer_modulus")
MIN_INNER_RADIUS_PER_GROOVE_WIDTH, MIN_HEIGHT_PER_GROOVE_DEPTH = 0.55, 1.25
DEFAULT_RADIUS_FACTOR = 1.4  # times the start's outer radius: its limit unless one is given
TISSUE_SHARE = 0.95  # of the tissue's radius or half breadth that a probe may cover
MODULUS_DIGITS = 3  # of moduli; lengths are rounded to 0.01 mm
SAME_DESIGN_TOLERANCE_RELATIVE = 0.005  # relative: designs that differ less are one, and a limit this near is active
BOUNDS_TOLERANCE_RELATIVE = 1e-9  # relative: bounds this near are one value


@dataclass(frozen=True)
class Limit:
    """One limit of the designs.

    Attributes
    ----------
    name
        Name of the limit, such as ``least gap``.
    value
        Value of the limit, SI.
    active
        Whether the design reaches the limit.
    """

    name: str
    value: float
    active: bool


@dataclass(frozen=True)
class ProbeSizes:
    """The varied numbers of probes by name, SI: floats, arrays that may be complex, or casadi expressions."""

    inner_radius: Numeric
    area_ratio: Numeric
    gap: Numeric
    inner_height: Numeric
    outer_height: Numeric
    inner_modulus: Numeric
    outer_modulus: Numeric

    @classmethod
    def from_scene(cls, scene: Scene) -> ProbeSizes:
        """Return the sizes of a scene's probe."""
        probe = scene.probe
        moduli = probe.inner.youngs_modulus, probe.outer.youngs_modulus
        return cls(
            probe.inner_radius, probe.inner_area / probe.outer_area, probe.gap, probe.core_height, probe.tube_height, *moduli
        )

    @classmethod
    def from_vector(cls, x: Numeric) -> ProbeSizes:
        """Return the sizes of designs x, whose first axis is that of the variables: six with one height, seven with two."""
        numbers = dict(zip(name_variables(len(x)), x, strict=True))
        if "height" in numbers:
            height = numbers.pop("height")
            numbers |= {"inner_height": height, "outer_height": height}
        return cls(**numbers)

    @property
    def outer_radius(self) -> Numeric:
        """The outer block's radius, from A2/A1."""
        return ((self.inner_radius + self.gap) ** 2 + self.inner_radius**2 / self.area_ratio) ** 0.5

    @property
    def wall(self) -> Numeric:
        """The outer block's thickness."""
        return self.outer_radius - self.inner_radius - self.gap

    @property
    def areas(self) -> tuple[Numeric, Numeric]:
        """End areas of the inner and the outer block."""
        return np.pi * self.inner_radius**2, np.pi * self.inner_radius**2 / self.area_ratio

    @property
    def heights(self) -> tuple[Numeric, Numeric]:
        """Of the inner and the outer block."""
        return self.inner_height, self.outer_height

    @property
    def moduli(self) -> tuple[Numeric, Numeric]:
        """Of the inner and the outer block."""
        return self.inner_modulus, self.outer_modulus

    def build_vector(self, names: tuple[str, ...]) -> Floats:
        """Return the variables of some names; one height is the inner block's."""
        return np.array([getattr(self, "inner_height" if name == "height" else name) for name in names])

    def build_parameters(self, poisson: Numeric) -> Numeric:
        """Return the closed form's probe parameters, in the order of ``PROBE_PARAMETERS``, given both Poisson's ratios."""
        ones = self.inner_radius / self.inner_radius
        lengths = (self.inner_radius, self.gap, self.outer_radius, *self.heights)
        return np.array([*lengths, self.inner_modulus, poisson[0] * ones, self.outer_modulus, poisson[1] * ones])


def name_variables(count: int) -> tuple[str, ...]:
    """Return the names of the variables of designs with so many."""
    return SHARED_HEIGHT_NAMES if count == len(SHARED_HEIGHT_NAMES) else SEPARATE_HEIGHT_NAMES


def has_separate_heights(scene: Scene) -> bool:
    """Return whether the two blocks of a scene's probe have different heights."""
    return scene.probe.core_height != scene.probe.tube_height


def read_vector(scene: Scene, names: tuple[str, ...] | None = None) -> Floats:
    """Return the design of a scene's probe, SI; by default its heights decide on the names."""
    return ProbeSizes.from_scene(scene).build_vector(
        names or (SEPARATE_HEIGHT_NAMES if has_separate_heights(scene) else SHARED_HEIGHT_NAMES)
    )


def _compute_distance(first: Scene, second: Scene) -> float:
    """Return the largest difference of two scenes' probes in the logarithms of their variables."""
    designs = (read_vector(scene, SEPARATE_HEIGHT_NAMES) for scene in (first, second))
    return float(np.max(np.abs(np.subtract(*map(np.log, designs)))))


def is_same_design(first: Scene, second: Scene, tolerance: float = SAME_DESIGN_TOLERANCE_RELATIVE) -> bool:
    """Return whether two scenes' probes agree in every variable within a relative tolerance, and in Poisson's ratios."""
    poisson = [(scene.probe.inner.poisson_ratio, scene.probe.outer.poisson_ratio) for scene in (first, second)]
    return poisson[0] == poisson[1] and _compute_distance(first, second) <= tolerance


def format_variable(name: str, value: float) -> Any:
    """Return a variable with its unit, as a design file writes it."""
    if name == "area_ratio":
        return f"{value:g}"
    return (MODULUS_QUANTITY if name in MODULUS_NAMES else LENGTH_QUANTITY).format_value(value)


@dataclass(frozen=True)
class VariableSpace:
    """The limits of the variables, SI, and the constraints between them.

    Each limit follows from the start and from what a workshop can make, none from another. A tighter limit therefore only removes
    designs.

    Attributes
    ----------
    scene
        The scene whose probe is varied; everything else in it stays.
    names
        Names of the variables.
    low, high
        Bounds, shape (variables,).
    outer_radius
        Limit of the outer block's radius, m.
    wall
        Minimum thickness of the outer block, m.
    """

    scene: Scene
    names: tuple[str, ...]
    low: Floats
    high: Floats
    outer_radius: float
    wall: float

    @property
    def free(self) -> list[int]:
        """Indices of the variables whose bounds are not one value."""
        return [k for k in range(len(self.low)) if self.low[k] < self.high[k] * (1 - BOUNDS_TOLERANCE_RELATIVE)]

    def pin(self, values: Mapping[str, float]) -> VariableSpace:
        """Return the space with some variables, by name, held at a value."""
        low, high = self.low.copy(), self.high.copy()
        for name, value in values.items():
            k = self.names.index(name)
            low[k] = high[k] = value
        return replace(self, low=low, high=high)

    def admits(self, x: Floats, tolerance: float = 0.0) -> NDArray[np.bool_]:
        """Return which designs x, shape (variables, n), meet the constraints of outer radius and wall."""
        sizes = ProbeSizes.from_vector(x)
        return np.asarray(
            (sizes.outer_radius <= self.outer_radius * (1 + tolerance)) & (sizes.wall >= self.wall * (1 - tolerance))
        )

    def admits_scene(self, scene: Scene) -> bool:
        """Return whether a scene's probe is within the limits of outer radius and wall and the bounds, allowing for rounding."""
        vector, probe = read_vector(scene, self.names), scene.probe
        inside: NDArray[np.bool_] = (vector >= 0.995 * self.low) & (vector <= 1.005 * self.high)
        wall = probe.tube_radius - probe.hole_radius
        return bool(
            inside.all() and probe.tube_radius <= self.outer_radius * (1 + 1e-9) and wall >= self.wall * (1 - 1e-9) - 1e-9
        )

    def build_scene(self, x: Floats, exact: Mapping[str, float] | None = None) -> Scene | None:
        """Return the scene with a design rounded to what is ordered from a workshop; None where that breaks a rule.

        Parameters
        ----------
        x
            The design.
        exact
            Variables, by name, that are not rounded.
        """
        sizes, exact = ProbeSizes.from_vector(x), exact or {}
        lengths = {"gap": sizes.gap} | {name: getattr(sizes, name) for name in ("inner_height", "outer_height")}
        if "height" in self.names:
            lengths = {"gap": sizes.gap, "height": sizes.inner_height}
        lengths = {name: round(float(length), 5) for name, length in lengths.items()}
        lengths["outer_radius"] = _round_length_down(float(sizes.outer_radius))
        lengths["inner_radius"] = min(
            round(float(sizes.inner_radius), 5), _round_length_down(lengths["outer_radius"] - lengths["gap"] - self.wall)
        )  # or rounding would thin a wall of the least thickness
        if set(exact) - {"area_ratio"}:
            lengths |= {name: value for name, value in exact.items() if name not in MODULUS_NAMES}
        if "area_ratio" in lengths:
            del lengths["outer_radius"]
        starting = (block.youngs_modulus for block in (self.scene.probe.inner, self.scene.probe.outer))
        moduli = [
            exact.get(name, start if _round_modulus(value) == _round_modulus(start) else _round_modulus(value))
            for name, value, start in zip(MODULUS_NAMES, sizes.moduli, starting, strict=True)
        ]  # the start's own stays as it is, and so does its material's name
        return self._replace_probe(lengths, moduli)

    def build_exact_scene(self, x: Floats) -> Scene | None:
        """Return the scene with a design as it is, not rounded; None where that breaks a rule."""
        numbers = dict(zip(self.names, x.tolist(), strict=True))
        moduli = [numbers.pop(name) for name in MODULUS_NAMES]
        return self._replace_probe(numbers, moduli)

    def _replace_probe(self, lengths: Mapping[str, float], moduli: list[float]) -> Scene | None:
        replaced = {"area_ratio", "outer_radius", "height", "inner_height", "outer_height"}
        probe = self.scene.probe.model_dump(exclude=replaced, exclude_unset=True) | dict(lengths)
        for block, modulus in zip(BLOCK_NAMES, moduli, strict=True):
            set_number(probe[block], "youngs_modulus", modulus)
        try:
            return Scene.model_validate(self.scene.model_dump(exclude_unset=True) | {"probe": probe}, context=SI_CONTEXT)
        except ValueError:
            return None

    def list_limits(self, scene: Scene) -> tuple[Limit, ...]:
        """Return all limits, and whether a scene's probe reaches them."""
        probe, vector = scene.probe, read_vector(scene, self.names)
        rows = [
            ("largest outer_radius", self.outer_radius, probe.tube_radius),
            ("least wall", self.wall, probe.tube_radius - probe.hole_radius),
            ("least inner_radius", self.low[0], vector[0]),
        ]
        for name, low, high, value in list(zip(self.names, self.low, self.high, vector, strict=True))[1:]:
            rows += [(f"least {name}", low, value), (f"largest {name}", high, value)]
        return tuple(
            Limit(name, float(limit), bool(abs(value - limit) <= SAME_DESIGN_TOLERANCE_RELATIVE * limit))
            for name, limit, value in rows
        )


def _round_modulus(modulus: float) -> float:
    """Return the modulus to ``MODULUS_DIGITS`` figures."""
    return float(f"{modulus:.{MODULUS_DIGITS}g}")


def _round_length_down(length: float) -> float:
    """Return the next shorter length in steps of 0.01 mm."""
    return math.floor(length * 1e5 + 1e-6) / 1e5


def build_space(scene: Scene, outer_radius: float | None = None, names: tuple[str, ...] = SHARED_HEIGHT_NAMES) -> VariableSpace:
    """Return the space around a scene's probe; the limit of the outer radius is 1.4 times the start's unless given.

    If the start is beyond another limit, this limit is moved to the start.

    Raises
    ------
    InputError
        No probe fits within the limit, or on the tissue.
    """
    probe, tissue, start = scene.probe, scene.tissue, read_vector(scene, names)
    limit = DEFAULT_RADIUS_FACTOR * probe.tube_radius if outer_radius is None else outer_radius
    if tissue.shape != "half-space":
        limit = min(limit, TISSUE_SHARE * (tissue.radius if tissue.shape == "cylinder" else tissue.breadth / 2))
    low = np.array([min(VARIABLES[name].low, value) for name, value in zip(names, start, strict=True)])
    high = np.array([max(VARIABLES[name].high, value) for name, value in zip(names, start, strict=True)])
    for k, name in enumerate(names):
        low[k] = max(low[k], _find_groove_limit(probe, name))
    wall = min(MIN_WALL_M, probe.tube_radius - probe.hole_radius)
    gap = low[names.index("gap")]
    high[0] = limit - gap - wall
    if high[0] <= low[0]:
        min_radius = format_mm(low[0] + gap + wall)
        raise InputError("outer-radius", format_mm(limit), f"above {min_radius}: inner block, gap and wall need as much")
    return VariableSpace(scene, names, low, high, limit, wall)


def _find_groove_limit(probe: Probe, name: str) -> float:
    """Return the smallest value of a variable for which the probe's groove fits; 0 without a groove."""
    if probe.groove is None:
        return 0.0
    if name == "inner_radius":
        return MIN_INNER_RADIUS_PER_GROOVE_WIDTH * probe.groove.width
    return MIN_HEIGHT_PER_GROOVE_DEPTH * probe.groove.depth if name in ("height", "outer_height") else 0.0
