"""The designs that a search may choose from: bounds, constraints, discrete values and materials.

Variables are those of ``optimisation.design_space``; what a design file leaves out of them varies within what a workshop can
make, round the start. Limits take designs away and bring none.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from geometry.scenes.catalogue import CatalogueMaterial, find_material, set_number
from geometry.scenes.scene import Scene
from geometry.scenes.variables import BLOCK_NAMES
from probe_design.design_search.bounds import (
    MODULUS_INDICES,
    build_default_space,
    find_bounds,
    format_value,
    limit_height,
    limit_radius,
)
from probe_design.design_search.heights import (
    INNER_HEIGHT_INDEX,
    OUTER_HEIGHT_INDEX,
    read_design_vector,
    set_heights,
    variable_names,
)
from probe_design.optimisation.design_space import VARIABLES, Space
from probe_design.populations.design_file import Design
from probe_design.populations.variables import DesignVariable


@dataclass(frozen=True)
class Combination:
    """One value for each discrete variable and one material for each block.

    Attributes:
        pinned: values of variables by their index, see ``heights``, SI.
        poisson: Poisson's ratios of the inner and the outer block; None: the start's.
        materials: names of both, empty where none were asked for.
        names: of the variables.
    """

    pinned: Mapping[int, float]
    poisson: tuple[float, float]
    materials: tuple[str, ...] = ()
    names: tuple[str, ...] = VARIABLES

    @property
    def description(self) -> str:
        """The chosen values and materials in words."""
        values = [
            f"{self.names[k]} {format_value(k, v)}"
            for k, v in self.pinned.items()
            if not (self.materials and k in MODULUS_INDICES)
        ]
        return ", ".join([*values, *(["materials " + " / ".join(self.materials)] if self.materials else [])])

    def name_blocks(self, probe: dict[str, Any]) -> None:
        """Write the materials' names into a probe's tables, which have their numbers."""
        for block, name in zip(BLOCK_NAMES, self.materials, strict=False):
            probe[block]["material"] = name


@dataclass(frozen=True)
class SearchSpace:
    """The designs of a design file.

    Attributes:
        space: bounds and constraints of the relaxed variables, every one continuous.
        grids: the only values of what comes in steps or choices, increasing, by index.
        shelf: the materials that a block may be of; empty: moduli by themselves.
        start_poisson: the start's Poisson's ratios.
    """

    space: Space
    grids: Mapping[int, tuple[float, ...]]
    shelf: tuple[CatalogueMaterial, ...]
    start_poisson: tuple[float, float]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the variables: six, or seven where blocks have heights of their own."""
        return variable_names(len(self.space.low) > len(VARIABLES))

    @property
    def combinations(self) -> int:
        """The number of combinations."""
        return math.prod(len(values) for values in self.grids.values()) * max(1, len(self.shelf) ** 2)

    def iterate_combinations(self) -> Iterator[Combination]:
        """Yield all combinations, in the order of the file."""
        for values in product(*self.grids.values()):
            yield from self._iterate_materials(dict(zip(self.grids, values, strict=True)), self.shelf, self.shelf)

    def iterate_materials(self, held: Mapping[int, float]) -> Iterator[Combination]:
        """Yield all pairs of materials beside held values of grids."""
        yield from self._iterate_materials(dict(held), self.shelf, self.shelf)

    @property
    def shelf_poisson(self) -> list[float]:
        """Poisson's ratios of the materials."""
        return [get_poisson_ratio(material) for material in self.shelf]

    def iterate_nearest(self, design: Floats, count: int = 2) -> Iterator[Combination]:
        """Yield the combinations nearest to a design: of each grid and of the materials of each block, the nearest values."""
        grids = {k: _find_nearest_values(values, design[k], count) for k, values in self.grids.items()}
        shelves = [self._find_nearest_materials(design[k], count) for k in MODULUS_INDICES]
        for values in product(*grids.values()):
            yield from self._iterate_materials(dict(zip(grids, values, strict=True)), *shelves)

    def pin_combination(self, combination: Combination) -> Space:
        """Return the bounds with a combination's values as both ends."""
        low, high = self.space.low.copy(), self.space.high.copy()
        for k, value in combination.pinned.items():
            low[k] = high[k] = value
        return replace(self.space, low=low, high=high)

    def list_free_variables(self, combination: Combination | None = None) -> list[int]:
        """Return indices of the variables that a combination (None: the relaxed problem) leaves open."""
        held = {} if combination is None else combination.pinned
        return [k for k in range(len(self.names)) if k not in held and self.space.low[k] < self.space.high[k]]

    def build_scene(self, design: Floats, combination: Combination) -> Scene | None:
        """Return the scene with a design rounded as a workshop makes it; None where that breaks a rule."""
        space = self.space
        made = _build_rounded_scene(space, design, combination)
        if made is None:
            return None
        probe = made.probe.model_dump(exclude_unset=True)
        for block, poisson in zip(BLOCK_NAMES, combination.poisson, strict=True):
            set_number(probe[block], "poisson_ratio", poisson)
        combination.name_blocks(probe)
        try:
            return Scene.model_validate(made.model_dump(exclude_unset=True) | {"probe": probe})
        except ValueError:
            return None

    def build_exact_scene(self, design: Floats, combination: Combination) -> Scene | None:
        """Return the scene with a design as it is, not rounded; None where that breaks a rule."""
        probe = self.space.scene.probe.model_dump(exclude={"outer_radius", "inner_height", "outer_height"}, exclude_unset=True)
        probe |= dict(zip(VARIABLES[:4], design[:4].tolist(), strict=True))
        for block, modulus, poisson in zip(BLOCK_NAMES, design[list(MODULUS_INDICES)].tolist(), combination.poisson, strict=True):
            set_number(probe[block], "youngs_modulus", modulus)
            set_number(probe[block], "poisson_ratio", poisson)
        combination.name_blocks(probe)
        try:
            made = Scene.model_validate(self.space.scene.model_dump(exclude_unset=True) | {"probe": probe})
            return (
                set_heights(made, *design[[INNER_HEIGHT_INDEX, OUTER_HEIGHT_INDEX]].tolist())
                if len(design) > OUTER_HEIGHT_INDEX
                else made
            )
        except ValueError:
            return None

    def _iterate_materials(
        self, held: dict[int, float], inner: tuple[CatalogueMaterial, ...], outer: tuple[CatalogueMaterial, ...]
    ) -> Iterator[Combination]:
        if not self.shelf:
            yield Combination(held, self.start_poisson, names=self.names)
            return
        for inner_material, outer_material in product(inner, outer):
            moduli = {4: inner_material.youngs_modulus, 5: outer_material.youngs_modulus}
            yield Combination(
                held | moduli,
                (get_poisson_ratio(inner_material), get_poisson_ratio(outer_material)),
                (inner_material.name, outer_material.name),
                self.names,
            )

    def _find_nearest_materials(self, modulus: float, count: int) -> tuple[CatalogueMaterial, ...]:
        return tuple(sorted(self.shelf, key=lambda material: abs(math.log(material.youngs_modulus / modulus)))[:count])


def build_search_space(design: Design) -> SearchSpace:
    """Build the search space of a design file.

    Raises:
        InputError: a variable has no value within the limits, a material is not one for blocks, or there is no room for a probe.
    """
    scene, given, limits = design.scene, design.variables, design.limits
    base = build_default_space(design)
    separate_heights, start = len(base.low) > len(VARIABLES), read_design_vector(scene, len(base.low) > len(VARIABLES))
    low, high, grids = base.low.copy(), base.high.copy(), dict[int, tuple[float, ...]]()
    shelf = tuple(_find_block_material(name, k) for k, name in enumerate(dict.fromkeys(given.materials)))
    for k, name in enumerate(variable_names(separate_heights)):
        variable: DesignVariable = getattr(given, name)
        if shelf and k in MODULUS_INDICES:
            _check_not_given(name, variable)
            moduli = [material.youngs_modulus for material in shelf]
            low[k], high[k] = min(moduli), max(moduli)
            continue
        low[k], high[k], values = find_bounds(name, variable, low[k], high[k], start[k])
        if values:
            grids[k] = values
    wall = base.wall if limits.wall is None else limits.wall
    for k in (INNER_HEIGHT_INDEX, OUTER_HEIGHT_INDEX)[: 1 + separate_heights]:
        limit_height(design, k, low, high, grids=grids)
    limit_radius(design, low, high, base.outer_radius, wall)
    limited_space = replace(base, low=low, high=high, wall=wall)
    poisson = scene.probe.inner.poisson_ratio, scene.probe.outer.poisson_ratio
    return SearchSpace(limited_space, grids, shelf, poisson)


def get_poisson_ratio(material: CatalogueMaterial) -> float:
    """Return a material's Poisson's ratio."""
    return material.poisson_ratio


def _find_block_material(name: str, k: int) -> CatalogueMaterial:
    try:
        material = find_material(name)
    except InputError as fault:
        raise InputError(f"variables.materials[{k}]", name, fault.allowed) from None
    if "poisson_ratio" not in material.numbers or material.kind != "elastomer":
        raise InputError(f"variables.materials[{k}]", name, f"materials of blocks: elastomers; {name} is of kind {material.kind}")
    return material


def _check_not_given(name: str, variable: DesignVariable) -> None:
    if variable != DesignVariable():
        raise InputError(f"variables.{name}", "given", "nothing beside materials, which pick the moduli")


def _find_nearest_values(values: tuple[float, ...], value: float, count: int) -> tuple[float, ...]:
    return tuple(sorted(sorted(values, key=lambda candidate: abs(math.log(candidate / value)))[:count]))


def _build_rounded_scene(space: Space, design: Floats, combination: Combination) -> Scene | None:
    """Return the scene of a design with its discrete values exact and all others rounded, or None if it is not valid."""
    made = space.build_scene(design)
    if made is None or not set(combination.pinned) - {1}:
        return made
    probe = made.probe.model_dump(exclude_unset=True)
    for k, value in combination.pinned.items():
        if k in MODULUS_INDICES:
            set_number(probe[BLOCK_NAMES[k == MODULUS_INDICES[1]]], "youngs_modulus", value)
        elif k != 1:
            probe[combination.names[k]] = value
    if 1 in combination.pinned:
        del probe["outer_radius"]
        probe["area_ratio"] = combination.pinned[1]
    try:
        return Scene.model_validate(made.model_dump(exclude_unset=True) | {"probe": probe})
    except ValueError:
        return None


def is_admissible(search_space: SearchSpace, scene: Scene) -> bool:
    """Return whether a scene's probe is within the limits of outer radius and wall and the bounds, allowing for rounding."""
    vector = read_design_vector(scene, len(search_space.space.low) > OUTER_HEIGHT_INDEX)
    inside: NDArray[np.bool_] = (vector >= 0.995 * search_space.space.low) & (vector <= 1.005 * search_space.space.high)
    probe = scene.probe
    wall = probe.tube_radius - probe.hole_radius
    keeps = (
        probe.tube_radius <= search_space.space.outer_radius * (1 + 1e-9) and wall >= search_space.space.wall * (1 - 1e-9) - 1e-9
    )
    return bool(inside.all() and keeps)
