"""The designs that a search may choose from: bounds, constraints, discrete values and materials.

Variables that a design file does not give vary around the start, within what a workshop can make. Limits remove designs and add
none: each follows from the start and from what a workshop can make, none from another.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from itertools import product
from operator import attrgetter, getitem
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.catalogue import CatalogueMaterial, find_material, set_number
from geometry.scenes.probe import Probe, format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.tissue_sides import compute_side_distance
from geometry.scenes.units import SI_CONTEXT
from geometry.scenes.variables import BLOCK_NAMES
from probe_design.design_search.combination import Combination
from probe_design.design_search.film_choices import FilmChoice, list_film_choices
from probe_design.design_search.scan_choices import ScanChoice, list_scan_choices
from probe_design.design_search.variables import (
    MODULUS_NAMES,
    SAME_DESIGN_TOLERANCE_RELATIVE,
    SEPARATE_HEIGHT_NAMES,
    SHARED_HEIGHT_NAMES,
    VARIABLES,
    Limit,
    ProbeSizes,
    has_separate_heights,
    list_multiples,
    read_vector,
)
from probe_design.populations.design_file import Design
from probe_design.populations.entries import DesignVariable

T = TypeVar("T")
MIN_WALL_M = 0.5e-3  # m
MIN_INNER_RADIUS_PER_GROOVE_WIDTH, MIN_HEIGHT_PER_GROOVE_DEPTH = 0.55, 1.25
DEFAULT_RADIUS_FACTOR = 1.4  # times the start's outer radius: its limit unless one is given
MAX_TISSUE_FRACTION = 0.95  # of the tissue's radius or half breadth that a probe may cover
BOUNDS_TOLERANCE_RELATIVE = 1e-9  # relative: bounds this near are one value
NEAREST_VALUES = 2  # of a grid, or materials, that a relaxed design is rounded to
MAX_STEPS = 10_000  # values of a variable with a step


@dataclass(frozen=True)
class SearchSpace:
    """The designs of a design file: the limits of the variables, SI, the constraints between them, and discrete values.

    Attributes
    ----------
    scene
        The scene whose probe is varied; everything else in it stays.
    names
        Names of the variables.
    low, high
        Bounds of the relaxed variables, every one continuous, shape (variables,).
    outer_radius
        Limit of the outer block's radius, m.
    wall
        Minimum thickness of the outer block, m.
    grids
        The allowed values of variables with steps or choices, increasing, by the variable's name.
    shelf
        The materials allowed for a block; empty if the moduli are variables themselves.
    film_choices
        The films and bonds allowed; empty if the scene's stay.
    scan_choices
        The scans allowed; empty if the design file's stays.
    """

    scene: Scene
    names: tuple[str, ...]
    low: Floats
    high: Floats
    outer_radius: float
    wall: float
    grids: Mapping[str, tuple[float, ...]]
    shelf: tuple[CatalogueMaterial, ...]
    film_choices: tuple[FilmChoice, ...] = ()
    scan_choices: tuple[ScanChoice, ...] = ()

    @property
    def start_poisson(self) -> tuple[float, float]:
        """The start's Poisson's ratios."""
        return self.scene.probe.inner.poisson_ratio, self.scene.probe.outer.poisson_ratio

    @property
    def free(self) -> list[int]:
        """Indices of the variables whose bounds are not one value."""
        return [k for k in range(len(self.low)) if self.low[k] < self.high[k] * (1 - BOUNDS_TOLERANCE_RELATIVE)]

    def pin(self, values: Mapping[str, float]) -> SearchSpace:
        """Return the space with some variables, by name, held at a value."""
        low, high = self.low.copy(), self.high.copy()
        for name, value in values.items():
            k = self.names.index(name)
            low[k] = high[k] = value
        return replace(self, low=low, high=high)

    def admits(self, x: Floats, tolerance: float = 0.0) -> NDArray[np.bool_]:
        """Return which designs x (variables, n) meet the constraints of outer radius and wall within a relative tolerance."""
        sizes = ProbeSizes.from_vector(x)
        return np.asarray(
            (sizes.outer_radius <= self.outer_radius * (1 + tolerance)) & (sizes.wall >= self.wall * (1 - tolerance))
        )

    def admits_scene(self, scene: Scene) -> bool:
        """Return whether a scene's probe is within the limits of outer radius and wall and the bounds, allowing for rounding."""
        vector, probe = read_vector(scene, self.names), scene.probe
        # half a per cent: rounding to a workshop's steps may leave the bounds
        inside: NDArray[np.bool_] = (vector >= 0.995 * self.low) & (vector <= 1.005 * self.high)
        wall = probe.tube_radius - probe.hole_radius
        return bool(
            inside.all() and probe.tube_radius <= self.outer_radius * (1 + 1e-9) and wall >= self.wall * (1 - 1e-9) - 1e-9
        )

    def build_scene(self, x: Floats, combination: Combination | None = None) -> Scene | None:
        """Return the scene with a design rounded to what is ordered from a workshop; None where that is no valid scene.

        The discrete values of a combination are not rounded.
        """
        exact = {} if combination is None else combination.pinned
        values = zip(self.names, x.tolist(), read_vector(self.scene, self.names).tolist(), strict=True)
        numbers = {name: VARIABLES[name].round(value, start) for name, value, start in values}
        outer_radius = _round_length_down(float(ProbeSizes.from_vector(x).outer_radius))
        # or rounding would thin a wall of the least thickness
        largest_radius = _round_length_down(outer_radius - numbers["gap"] - self.wall)
        numbers["inner_radius"] = min(numbers["inner_radius"], largest_radius)
        if set(exact) - {"area_ratio"}:
            numbers |= exact
        if set(exact) <= {"area_ratio"} or "area_ratio" not in exact:  # a pinned area ratio determines the outer radius
            del numbers["area_ratio"]
            numbers["outer_radius"] = outer_radius
        return self._replace_probe(numbers, combination)

    def build_exact_scene(self, x: Floats, combination: Combination | None = None) -> Scene | None:
        """Return the scene with a design x, shape (variables,), as it is, not rounded; None where that is no valid scene."""
        return self._replace_probe(dict(zip(self.names, x.tolist(), strict=True)), combination)

    def _replace_probe(self, numbers: Mapping[str, float], combination: Combination | None) -> Scene | None:
        """Return the scene with these numbers of the probe, and a combination's materials; None where that is no valid scene."""
        replaced = {"area_ratio", "outer_radius", "height", "inner_height", "outer_height"}
        probe = self.scene.probe.model_dump(exclude=replaced, exclude_unset=True)
        for name, value in numbers.items():
            _, *parents, key = (VARIABLES[name].key if name in VARIABLES else f"probe.{name}").split(".")
            set_number(reduce(getitem, parents, probe), key, value)
        if combination is not None and combination.materials:
            for block, poisson, material in zip(BLOCK_NAMES, combination.poisson, combination.materials, strict=True):
                probe[block] |= {"poisson_ratio": poisson, "material": material}
        if combination is not None and combination.film is not None:
            probe["film"] = combination.film.film.model_dump(exclude_unset=True)
        try:
            return Scene.model_validate(self.scene.model_dump(exclude_unset=True) | {"probe": probe}, context=SI_CONTEXT)
        except ValueError:
            return None

    def list_limits(self, scene: Scene) -> tuple[Limit, ...]:
        """Return all limits, and whether a scene's probe reaches each within ``SAME_DESIGN_TOLERANCE_RELATIVE``.

        What is fixed has none.
        """
        probe, vector = scene.probe, read_vector(scene, self.names)
        rows = [
            ("largest outer_radius", self.outer_radius, probe.tube_radius),
            ("least wall", self.wall, probe.tube_radius - probe.hole_radius),
            ("least inner_radius", self.low[0], vector[0]),  # its upper bound follows from the outer radius
        ]
        for name, low, high, value in list(zip(self.names, self.low, self.high, vector, strict=True))[1:]:
            rows += [(f"least {name}", low, value), (f"largest {name}", high, value)] if low < high else []
        return tuple(
            Limit(name, float(limit), bool(abs(value - limit) <= SAME_DESIGN_TOLERANCE_RELATIVE * limit))
            for name, limit, value in rows
        )

    @property
    def combinations(self) -> int:
        """The number of combinations of discrete values, pairs of materials if they are listed, films and bonds, and scans."""
        values = math.prod(len(values) for values in self.grids.values())
        return values * max(1, len(self.shelf) ** 2) * max(1, len(self.film_choices)) * max(1, len(self.scan_choices))

    def iterate_combinations(self) -> Iterator[Combination]:
        """Yield all combinations, in the order of the file."""
        for values in product(*self.grids.values()):
            yield from self.iterate_materials(dict(zip(self.grids, values, strict=True)))

    def iterate_materials(self, pinned: Mapping[str, float]) -> Iterator[Combination]:
        """Yield all pairs of materials for pinned values of grids."""
        yield from self._iterate_pairs(pinned, self.shelf, self.shelf)

    @property
    def shelf_poisson(self) -> list[float]:
        """Poisson's ratios of the materials."""
        return [material.poisson_ratio for material in self.shelf]

    def iterate_nearest(self, design: Floats) -> Iterator[Combination]:
        """Yield the combinations of the values of each grid, and materials of each block, nearest to a design's."""
        numbers = dict(zip(self.names, design.tolist(), strict=True))
        grids = {name: tuple(sorted(_find_nearest(values, float, numbers[name]))) for name, values in self.grids.items()}
        shelves = [_find_nearest(self.shelf, attrgetter("youngs_modulus"), numbers[name]) for name in MODULUS_NAMES]
        for values in product(*grids.values()):
            yield from self._iterate_pairs(dict(zip(grids, values, strict=True)), *shelves)

    def _iterate_pairs(
        self, pinned: Mapping[str, float], inner: tuple[CatalogueMaterial, ...], outer: tuple[CatalogueMaterial, ...]
    ) -> Iterator[Combination]:
        """Yield the pairs of materials of both blocks for pinned values, or these alone, with each film and each scan."""
        for film, scan in product(self.film_choices or (None,), self.scan_choices or (None,)):
            if not self.shelf:
                yield Combination(pinned, self.start_poisson, film=film, scan=scan)
                continue
            for pair in product(inner, outer):
                moduli = {name: material.youngs_modulus for name, material in zip(MODULUS_NAMES, pair, strict=True)}
                poisson = pair[0].poisson_ratio, pair[1].poisson_ratio
                yield Combination({**pinned, **moduli}, poisson, tuple(material.name for material in pair), film, scan)


def _find_nearest(items: Iterable[T], measure: Callable[[T], float], target: float) -> tuple[T, ...]:
    """Return the ``NEAREST_VALUES`` items whose measures have the ratio nearest to 1 to a target, the nearest first."""
    return tuple(sorted(items, key=lambda item: abs(math.log(measure(item) / target)))[:NEAREST_VALUES])


def build_search_space(design: Design) -> SearchSpace:
    """Build the search space of a design file: bounds that follow from the start, then the file's own, then its limits.

    If the start is beyond a bound that the file does not give, this bound is moved to the start.

    Raises
    ------
    InputError
        A variable has no value within the limits, a material is not one for blocks, or no probe fits.
    """
    scene, given = design.scene, design.variables
    names = SEPARATE_HEIGHT_NAMES if _check_heights(design) else SHARED_HEIGHT_NAMES
    outer_radius, min_wall = _find_max_radius(design), min(MIN_WALL_M, scene.probe.tube_radius - scene.probe.hole_radius)
    start = dict(zip(names, read_vector(scene, names).tolist(), strict=True))
    low = {name: max(min(VARIABLES[name].low, value), _find_groove_limit(scene.probe, name)) for name, value in start.items()}
    high = {name: max(VARIABLES[name].high, value) for name, value in start.items()}
    high["inner_radius"] = outer_radius - low["gap"] - min_wall
    if high["inner_radius"] <= low["inner_radius"]:
        raise _build_radius_error(format_mm(outer_radius), low["inner_radius"] + low["gap"] + min_wall)
    grids: dict[str, tuple[float, ...]] = {}
    shelf = tuple(_find_block_material(name, k) for k, name in enumerate(dict.fromkeys(given.materials)))
    for name, start_value in start.items():
        variable: DesignVariable = getattr(given, name)
        if shelf and name in MODULUS_NAMES:
            if variable != DesignVariable():
                raise InputError(f"variables.{name}", "given", "nothing beside materials, which pick the moduli")
            moduli = [material.youngs_modulus for material in shelf]
            low[name], high[name] = min(moduli), max(moduli)
            continue
        low[name], high[name], values = _find_bounds(name, variable, low[name], high[name], start_value)
        if "height" in name:
            low[name], high[name], values = _limit_height(design, name, low[name], high[name], values)
        if values:
            grids[name] = values
    wall = min_wall if design.limits.wall is None else design.limits.wall
    min_radius = low["inner_radius"] + low["gap"] + wall
    if min_radius > outer_radius * (1 + 1e-9):
        stated = "" if design.limits.outer_radius else ", as it is left out"
        raise _build_radius_error(Words(f"{format_mm(outer_radius)}{stated}"), min_radius)
    high["inner_radius"] = max(low["inner_radius"], min(high["inner_radius"], outer_radius - low["gap"] - wall))
    lower, upper = (np.array([ends[name] for name in names]) for ends in (low, high))
    choices = list_film_choices(design), list_scan_choices(design, outer_radius)
    return SearchSpace(scene, names, lower, upper, outer_radius, wall, grids, shelf, *choices)


def _find_max_radius(design: Design) -> float:
    """Return the limit of the outer radius, m: the file's or ``DEFAULT_RADIUS_FACTOR`` times the start's, within the tissue."""
    tissue, limit = design.scene.tissue, design.limits.outer_radius
    radius = DEFAULT_RADIUS_FACTOR * design.scene.probe.tube_radius if limit is None else limit
    return min(radius, MAX_TISSUE_FRACTION * float(compute_side_distance(tissue, 0.0, 0.0)))


def _build_radius_error(limit: Words, min_radius: float) -> InputError:
    """Return the error that refuses a limit of the outer radius below the smallest possible radius, m."""
    allowed = f"above {format_mm(min_radius)}: inner block, gap and wall need as much"
    return InputError("limits.outer_radius", limit, allowed)


def _find_groove_limit(probe: Probe, name: str) -> float:
    """Return the smallest value of a variable for which the probe's groove fits; 0 without a groove."""
    if probe.groove is None:
        return 0.0
    if name == "inner_radius":
        return MIN_INNER_RADIUS_PER_GROOVE_WIDTH * probe.groove.width
    return MIN_HEIGHT_PER_GROOVE_DEPTH * probe.groove.depth if name in ("height", "outer_height") else 0.0


def _round_length_down(length: float) -> float:
    """Return a length, m, rounded down to a multiple of 0.01 mm."""
    return math.floor(length * 1e5 + 1e-6) / 1e5  # + 1e-6: a multiple stays, even if its binary value is just below it


def _check_heights(design: Design) -> bool:
    """Return whether the two blocks have separate heights: the file gives them, or gives none and the start's heights differ.

    Raises
    ------
    InputError
        The file gives both kinds of height, or fixes one common height although the start has two.
    """
    height, given_heights, differ = design.variables.height, design.variables.given_heights, has_separate_heights(design.scene)
    if given_heights and height != DesignVariable():
        raise InputError("variables.height", "given", f"nothing beside {' and '.join(given_heights)}, in whose place it stands")
    if height.fixed and differ:
        raise InputError("variables.height", "fixed", "inner_height and outer_height, as the start's blocks differ in height")
    return bool(given_heights) or (differ and height == DesignVariable())


def _find_bounds(
    name: str, variable: DesignVariable, low: float, high: float, start: float
) -> tuple[float, float, tuple[float, ...]]:
    """Return the lower and upper bound of a variable and its discrete values, which are empty if it is continuous.

    ``low`` and ``high`` hold where the design file gives no bound; a fixed variable keeps the start's value.
    """
    if variable.fixed:
        return start, start, ()
    if variable.choices:
        return variable.choices[0], variable.choices[-1], variable.choices
    low, high = (low if variable.low is None else variable.low), (high if variable.high is None else variable.high)
    return low, high, () if variable.step is None else list_multiples(name, variable.step, low, high, MAX_STEPS)


def _limit_height(
    design: Design, name: str, low: float, high: float, values: tuple[float, ...]
) -> tuple[float, float, tuple[float, ...]]:
    """Return the bounds and discrete values of a height within ``limits.height``; refuse a limit below all of them."""
    limit = design.limits.height
    if limit is None:
        return low, high, values
    if low > limit:
        if getattr(design.variables, name) != DesignVariable() or design.scene.probe.groove is not None:
            raise InputError("limits.height", format_mm(limit), f"at least {format_mm(low)}, the least height of the blocks")
        low = limit  # the start is higher: a bound that was not requested
    high = max(low, min(high, limit))
    if values:
        values = tuple(value for value in values if value <= limit * (1 + 1e-9))
        if not values:
            remedy = "a limit that leaves one of the heights that step or choices allow"
            raise InputError("limits.height", format_mm(limit), remedy)
        high = values[-1]
    return low, high, values


def _find_block_material(name: str, k: int) -> CatalogueMaterial:
    """Return a catalogue material, the k-th of the design file; raise ``InputError`` where it is none for blocks."""
    try:
        material = find_material(name)
    except InputError as fault:
        raise InputError(f"variables.materials[{k}]", name, fault.allowed) from None
    if "poisson_ratio" not in material.numbers or material.kind != "elastomer":
        raise InputError(f"variables.materials[{k}]", name, f"materials of blocks: elastomers; {name} is of kind {material.kind}")
    return material
