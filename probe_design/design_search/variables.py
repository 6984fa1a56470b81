"""Define the numbers of a probe that a search varies, with their limits, and convert scenes to vectors and back.

Only ``VARIABLES`` lists them. A design is a vector x of the probe's numbers in the order of ``SearchSpace.names``, with one
height of both blocks, or with a height of each. The force is no part of it: a larger one never has a worse objective within
linear elasticity, so that the best is the largest allowed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats, Numeric
from geometry.common.errors import InputError, Words
from geometry.scenes.quantities import LENGTH_QUANTITY
from geometry.scenes.scene import Scene
from geometry.scenes.units import MODULUS_QUANTITY, PA_PER_KPA, Quantity
from probe_design.populations.entries import DesignVariable

MIN_RADIUS_M = 0.5e-3  # m: thinner cylinders of elastomer, and thinner sleeves, are not handled well
GAP_BOUNDS_M = (0.1e-3, 0.5e-3)  # m: narrower ones fill with glue, the paper found wider ones "less robust"
HEIGHT_BOUNDS_M = (1e-3, 20e-3)  # m: the thinnest sheet that is cut, the tallest block that stands
MODULUS_BOUNDS_PA = (10e3, 1e6)  # Pa: soft silicone gel to rubber a tenth as stiff as the paper's base, which counts as rigid
LENGTH_DECIMALS, ROUNDED_DIGITS = 5, 3  # of a design that is built: lengths in m to 0.01 mm, others to three digits
M_PER_MM = 1e-3  # SI value of the unit in tables
VALUES_BETWEEN_BOUNDS = 5  # of what is tried one by one, between bounds without a step: evenly spaced, lengths in their logarithm
MAX_LENGTHS = 50  # of what is tried one by one


@dataclass(frozen=True)
class Variable:
    """One number of the probe or its load that a search varies.

    Attributes
    ----------
    key
        Key of ``geometry.scenes.variables.list_values``.
    low, high
        Smallest and largest value that a workshop can make, SI.
    quantity
        Its unit and its text; None for a pure number.
    table_unit
        SI value and name of its unit in tables.
    """

    key: str
    low: float
    high: float
    quantity: Quantity | None = LENGTH_QUANTITY
    table_unit: tuple[float, str] = (M_PER_MM, " mm")

    def round(self, value: float, start: float) -> float:
        """Return a value as it is ordered: lengths to 0.01 mm, others to ``ROUNDED_DIGITS``, or the start's that rounds alike."""
        if self.quantity is LENGTH_QUANTITY:
            return round(value, LENGTH_DECIMALS)
        rounded, rounded_start = (float(f"{number:.{ROUNDED_DIGITS}g}") for number in (value, start))
        return start if rounded == rounded_start else rounded

    def format_value(self, value: float) -> str:
        """Return a value with its unit, as a design file writes it."""
        return f"{value:g}" if self.quantity is None else self.quantity.format_value(value)


MODULUS_UNIT = (MODULUS_QUANTITY, (PA_PER_KPA, " kPa"))
VARIABLES = {
    "inner_radius": Variable("probe.inner_radius", MIN_RADIUS_M, math.inf),
    "area_ratio": Variable("probe.area_ratio", 0.05, 20.0, None, (1.0, "")),
    "gap": Variable("probe.gap", *GAP_BOUNDS_M),
    "height": Variable("probe.height", *HEIGHT_BOUNDS_M),
    "inner_height": Variable("probe.inner_height", *HEIGHT_BOUNDS_M),
    "inner_modulus": Variable("probe.inner.youngs_modulus", *MODULUS_BOUNDS_PA, *MODULUS_UNIT),
    "outer_modulus": Variable("probe.outer.youngs_modulus", *MODULUS_BOUNDS_PA, *MODULUS_UNIT),
    "outer_height": Variable("probe.outer_height", *HEIGHT_BOUNDS_M),
    "force": Variable("load.force", 0.0, math.inf, None, (1e-3, " mN")),  # the largest allowed, which ``loads`` computes
}
SHARED_HEIGHT_NAMES = tuple(name for name in VARIABLES if name not in ("inner_height", "outer_height", "force"))
SEPARATE_HEIGHT_NAMES = tuple(name for name in VARIABLES if name not in ("height", "force"))
MODULUS_NAMES = ("inner_modulus", "outer_modulus")
SAME_DESIGN_TOLERANCE_RELATIVE = 0.005  # relative: designs that differ less are one, and a limit this near is active


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
        """The outer block's radius, from A2/A1, the ratio of the inner to the outer block's end area."""
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
        """Heights of the inner and the outer block."""
        return self.inner_height, self.outer_height

    @property
    def moduli(self) -> tuple[Numeric, Numeric]:
        """Young's moduli of the inner and the outer block."""
        return self.inner_modulus, self.outer_modulus

    def build_vector(self, names: tuple[str, ...]) -> Floats:
        """Return the variables with these names as a vector; ``height`` stands for both blocks' and is read from the inner."""
        return np.array([getattr(self, "inner_height" if name == "height" else name) for name in names])

    def build_parameters(self, poisson: Numeric) -> Numeric:
        """Return the closed form's probe parameters, in the order of ``PROBE_PARAMETERS``, given both Poisson's ratios."""
        ones = self.inner_radius / self.inner_radius
        # ones: of the shape and type (float, complex) of the sizes
        lengths = (self.inner_radius, self.gap, self.outer_radius, *self.heights)
        return np.array([*lengths, self.inner_modulus, poisson[0] * ones, self.outer_modulus, poisson[1] * ones])


def name_variables(count: int) -> tuple[str, ...]:
    """Return the names of the variables of designs with ``count`` of them: one height of both blocks, or one of each."""
    return SHARED_HEIGHT_NAMES if count == len(SHARED_HEIGHT_NAMES) else SEPARATE_HEIGHT_NAMES


def has_separate_heights(scene: Scene) -> bool:
    """Return whether the two blocks of a scene's probe have different heights."""
    return scene.probe.core_height != scene.probe.tube_height


def read_vector(scene: Scene, names: tuple[str, ...] | None = None) -> Floats:
    """Return the design of a scene's probe as a vector, SI.

    Its variables are those of ``names``; by default with one height if both blocks have the same, else with two.
    """
    return ProbeSizes.from_scene(scene).build_vector(
        names or (SEPARATE_HEIGHT_NAMES if has_separate_heights(scene) else SHARED_HEIGHT_NAMES)
    )


def _compute_distance(first: Scene, second: Scene) -> float:
    """Return the largest difference of two scenes' probes in the logarithms of their variables."""
    designs = (read_vector(scene, SEPARATE_HEIGHT_NAMES) for scene in (first, second))
    return float(np.max(np.abs(np.subtract(*map(np.log, designs)))))


def is_same_design(first: Scene, second: Scene, tolerance: float = SAME_DESIGN_TOLERANCE_RELATIVE) -> bool:
    """Return whether two scenes' probes agree in every variable within a relative tolerance, and in Poisson's ratios, films."""
    poisson = [(scene.probe.inner.poisson_ratio, scene.probe.outer.poisson_ratio) for scene in (first, second)]
    return poisson[0] == poisson[1] and first.probe.film == second.probe.film and _compute_distance(first, second) <= tolerance


def format_variable(name: str, value: float) -> str:
    """Return a variable with its unit, as a design file writes it; those of films and scans are lengths."""
    return VARIABLES[name].format_value(value) if name in VARIABLES else LENGTH_QUANTITY.format_value(value)


def list_lengths(name: str, variable: DesignVariable) -> tuple[float, ...]:
    """Return the lengths, m, of a variable whose values are tried one by one; none where the design file's own stays."""
    if variable.choices:
        return variable.choices
    if variable.low is None or variable.high is None:
        if variable.step is not None:
            raise InputError(f"variables.{name}", Words("a step without bounds"), "bounds beside step, or choices")
        return ()
    if variable.step is None:
        return tuple(np.geomspace(variable.low, variable.high, VALUES_BETWEEN_BOUNDS).tolist())
    return list_multiples(name, variable.step, variable.low, variable.high, MAX_LENGTHS)


def list_multiples(name: str, step: float, low: float, high: float, max_count: int) -> tuple[float, ...]:
    """Return the multiples of a step that lie between the bounds, themselves included; refuse none or too many."""
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    if last - first >= max_count or last < first:
        requirement = f"wide enough for at most {max_count} values" if last >= first else "with a multiple between the bounds"
        ends = f"{format_variable(name, low)} to {format_variable(name, high)}"
        raise InputError(f"variables.{name}.step", format_variable(name, step), f"a step {requirement} of {ends}")
    # 12 digits: 3 * 0.1 gives 0.3, not 0.30000000000000004
    return tuple(float(f"{n * step:.12g}") for n in range(first, last + 1))
