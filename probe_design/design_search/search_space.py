"""The designs that a search may choose from: bounds, constraints, discrete values and materials.

Variables that a design file does not give vary around the start, within what a workshop can make. Limits remove designs and add
none.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.catalogue import CatalogueMaterial, find_material, set_number
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from geometry.scenes.units import SI_CONTEXT
from geometry.scenes.variables import BLOCK_NAMES
from probe_design.design_search.variables import (
    MODULUS_NAMES,
    SEPARATE_HEIGHT_NAMES,
    SHARED_HEIGHT_NAMES,
    VariableSpace,
    build_space,
    format_variable,
    has_separate_heights,
    read_vector,
)
from probe_design.populations.design_file import Design
from probe_design.populations.variables import DesignVariable

MOST_STEPS = 10_000


@dataclass(frozen=True)
class Combination:
    """One value for each discrete variable and one material for each block.

    Attributes
    ----------
    pinned
        Values of variables by their names, SI.
    poisson
        Poisson's ratios of the inner and the outer block.
    materials
        Names of both blocks' materials, empty if none were requested.
    """

    pinned: Mapping[str, float]
    poisson: tuple[float, float]
    materials: tuple[str, ...] = ()

    @property
    def description(self) -> str:
        """The chosen values and materials in words."""
        values = [
            f"{name} {format_variable(name, value)}"
            for name, value in self.pinned.items()
            if not (self.materials and name in MODULUS_NAMES)
        ]
        return ", ".join([*values, *(["materials " + " / ".join(self.materials)] if self.materials else [])])

    def set_materials(self, scene: Scene | None) -> Scene | None:
        """Return a scene whose blocks have these Poisson's ratios and materials' names; None where that breaks a rule."""
        if scene is None:
            return None
        probe = scene.probe.model_dump(exclude_unset=True)
        for block, poisson in zip(BLOCK_NAMES, self.poisson, strict=True):
            set_number(probe[block], "poisson_ratio", poisson)
        for block, name in zip(BLOCK_NAMES, self.materials, strict=False):
            probe[block]["material"] = name
        try:
            return Scene.model_validate(scene.model_dump(exclude_unset=True) | {"probe": probe}, context=SI_CONTEXT)
        except ValueError:
            return None


@dataclass(frozen=True)
class SearchSpace:
    """The designs of a design file.

    Attributes
    ----------
    space
        Bounds and constraints of the relaxed variables, every one continuous.
    grids
        The allowed values of variables with steps or choices, increasing, by the variable's name.
    shelf
        The materials allowed for a block; empty if the moduli are variables themselves.
    start_poisson
        The start's Poisson's ratios.
    """

    space: VariableSpace
    grids: Mapping[str, tuple[float, ...]]
    shelf: tuple[CatalogueMaterial, ...]
    start_poisson: tuple[float, float]

    @property
    def combinations(self) -> int:
        """The number of combinations."""
        return math.prod(len(values) for values in self.grids.values()) * max(1, len(self.shelf) ** 2)

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

    def iterate_nearest(self, design: Floats, count: int = 2) -> Iterator[Combination]:
        """Yield the combinations nearest to a design: of each grid and of the materials of each block, the nearest values."""
        numbers = dict(zip(self.space.names, design.tolist(), strict=True))
        grids = {name: _find_nearest_values(values, numbers[name], count) for name, values in self.grids.items()}
        shelves = [self._find_nearest_materials(numbers[name], count) for name in MODULUS_NAMES]
        for values in product(*grids.values()):
            yield from self._iterate_pairs(dict(zip(grids, values, strict=True)), *shelves)

    def pin_combination(self, combination: Combination) -> VariableSpace:
        """Return the bounds with a combination's values as both ends."""
        return self.space.pin(combination.pinned)

    def build_scene(self, design: Floats, combination: Combination) -> Scene | None:
        """Return the scene with a design rounded as a workshop makes it; None where that breaks a rule."""
        return combination.set_materials(self.space.build_scene(design, combination.pinned))

    def build_exact_scene(self, design: Floats, combination: Combination) -> Scene | None:
        """Return the scene with a design as it is, not rounded; None where that breaks a rule."""
        return combination.set_materials(self.space.build_exact_scene(design))

    def _iterate_pairs(
        self, pinned: Mapping[str, float], inner: tuple[CatalogueMaterial, ...], outer: tuple[CatalogueMaterial, ...]
    ) -> Iterator[Combination]:
        if not self.shelf:
            yield Combination(pinned, self.start_poisson)
            return
        for pair in product(inner, outer):
            moduli = {name: material.youngs_modulus for name, material in zip(MODULUS_NAMES, pair, strict=True)}
            poisson = pair[0].poisson_ratio, pair[1].poisson_ratio
            yield Combination({**pinned, **moduli}, poisson, tuple(material.name for material in pair))

    def _find_nearest_materials(self, modulus: float, count: int) -> tuple[CatalogueMaterial, ...]:
        return tuple(sorted(self.shelf, key=lambda material: abs(math.log(material.youngs_modulus / modulus)))[:count])


def _find_nearest_values(values: tuple[float, ...], value: float, count: int) -> tuple[float, ...]:
    return tuple(sorted(sorted(values, key=lambda candidate: abs(math.log(candidate / value)))[:count]))


def build_search_space(design: Design) -> SearchSpace:
    """Build the search space of a design file: bounds that follow from the start, then the file's own, then its limits.

    Raises
    ------
    InputError
        A variable has no value within the limits, a material is not one for blocks, or no probe fits.
    """
    scene, given, limits = design.scene, design.variables, design.limits
    names = SEPARATE_HEIGHT_NAMES if _check_heights(design) else SHARED_HEIGHT_NAMES
    try:
        base = build_space(scene, limits.outer_radius, names)
    except InputError as fault:
        raise InputError("limits.outer_radius", fault.value, fault.allowed) from None
    start, low, high = (
        read_vector(scene, names),
        dict(zip(names, base.low, strict=True)),
        dict(zip(names, base.high, strict=True)),
    )
    grids: dict[str, tuple[float, ...]] = {}
    shelf = tuple(_find_block_material(name, k) for k, name in enumerate(dict.fromkeys(given.materials)))
    for name, start_value in zip(names, start.tolist(), strict=True):
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
    wall = base.wall if limits.wall is None else limits.wall
    widest = base.outer_radius - low["gap"] - wall
    if low["inner_radius"] + low["gap"] + wall > base.outer_radius * (1 + 1e-9):
        limit = Words(f"{format_mm(base.outer_radius)}{'' if limits.outer_radius else ', as it is left out'}")
        min_radius = format_mm(low["inner_radius"] + low["gap"] + wall)
        raise InputError("limits.outer_radius", limit, f"above {min_radius}: inner block, gap and wall need as much")
    high["inner_radius"] = max(low["inner_radius"], min(high["inner_radius"], widest))
    lower, upper = (np.array([ends[name] for name in names]) for ends in (low, high))
    poisson = scene.probe.inner.poisson_ratio, scene.probe.outer.poisson_ratio
    return SearchSpace(VariableSpace(scene, names, lower, upper, base.outer_radius, wall), grids, shelf, poisson)


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
    """Return the lower and upper bound of a variable and its discrete values, which are empty if it is continuous."""
    if variable.fixed:
        return start, start, ()
    if variable.choices:
        return variable.choices[0], variable.choices[-1], variable.choices
    low, high = (low if variable.low is None else variable.low), (high if variable.high is None else variable.high)
    return low, high, () if variable.step is None else _list_steps(name, variable.step, low, high)


def _list_steps(name: str, step: float, low: float, high: float) -> tuple[float, ...]:
    """Return the multiples of a step that lie between the bounds."""
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    if last - first >= MOST_STEPS or last < first:
        requirement = f"wide enough for at most {MOST_STEPS} values" if last >= first else "with a multiple between the bounds"
        ends = f"{format_variable(name, low)} to {format_variable(name, high)}"
        raise InputError(f"variables.{name}.step", format_variable(name, step), f"a step {requirement} of {ends}")
    return tuple(float(f"{n * step:.12g}") for n in range(first, last + 1))


def _limit_height(
    design: Design, name: str, low: float, high: float, values: tuple[float, ...]
) -> tuple[float, float, tuple[float, ...]]:
    """Return the bounds and discrete values of a height within the limit of heights."""
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
    try:
        material = find_material(name)
    except InputError as fault:
        raise InputError(f"variables.materials[{k}]", name, fault.allowed) from None
    if "poisson_ratio" not in material.numbers or material.kind != "elastomer":
        raise InputError(f"variables.materials[{k}]", name, f"materials of blocks: elastomers; {name} is of kind {material.kind}")
    return material
