"""Bounds of the design variables: from the design file, then narrowed by its limits."""

from __future__ import annotations

import math
from typing import Any

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.probe import LENGTH_QUANTITY, format_mm
from geometry.scenes.units import MODULUS_QUANTITY
from probe_design.design_search.heights import (
    INNER_HEIGHT_INDEX,
    OUTER_HEIGHT_INDEX,
    build_separate_heights_space,
    has_different_heights,
    variable_names,
)
from probe_design.optimisation.design_space import Space, build_space
from probe_design.populations.design_file import Design
from probe_design.populations.variables import DesignVariable

MODULUS_INDICES = (4, 5)  # where those of inner and outer block are
MOST_STEPS = 10_000


def build_default_space(design: Design) -> Space:
    """Return the default bounds around the start, within the limit of the outer radius; raise ``InputError`` if none are left."""
    try:
        base = build_space(design.scene, design.limits.outer_radius)
    except InputError as fault:
        raise InputError("limits.outer_radius", fault.value, fault.allowed) from None
    return build_separate_heights_space(base) if _has_separate_heights(design) else base


def _has_separate_heights(design: Design) -> bool:
    """Return whether the two blocks have separate heights: the file gives them, or gives none and the start's heights differ.

    Raises:
        InputError: the file gives both kinds of height, or fixes one common height although the start has two.
    """
    height, given_heights, differ = design.variables.height, design.variables.given_heights, has_different_heights(design.scene)
    if given_heights and height != DesignVariable():
        raise InputError("variables.height", "given", f"nothing beside {' and '.join(given_heights)}, in whose place it stands")
    if height.fixed and differ:
        raise InputError("variables.height", "fixed", "inner_height and outer_height, as the start's blocks differ in height")
    return bool(given_heights) or (differ and height == DesignVariable())


def find_bounds(
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
    k = variable_names(separate_heights=True).index(name) if name != "height" else INNER_HEIGHT_INDEX
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    if last - first >= MOST_STEPS or last < first:
        requirement = "wide enough for at most 10000 values" if last >= first else "with a multiple between the bounds"
        raise InputError(
            f"variables.{name}.step",
            format_value(k, step),
            f"a step {requirement} of {format_value(k, low)} to {format_value(k, high)}",
        )
    return tuple(float(f"{n * step:.12g}") for n in range(first, last + 1))


def limit_height(design: Design, k: int, low: Floats, high: Floats, *, grids: dict[int, tuple[float, ...]]) -> None:
    """Lower the upper bound and the grid of height variable k to the limit of heights, in place."""
    limit = design.limits.height
    if limit is None:
        return
    if low[k] > limit:
        if (
            getattr(design.variables, variable_names(len(low) > OUTER_HEIGHT_INDEX)[k]) == DesignVariable()
            and design.scene.probe.groove is None
        ):
            low[k] = limit  # the start is higher: no bound that was asked for
        else:
            raise InputError("limits.height", format_mm(limit), f"at least {format_mm(low[k])}, the least height of the blocks")
    high[k] = max(low[k], min(high[k], limit))
    if k in grids:
        grids[k] = tuple(value for value in grids[k] if value <= limit * (1 + 1e-9))
        if not grids[k]:
            raise InputError(
                "limits.height", format_mm(limit), "a limit that leaves one of the heights that step or choices allow"
            )
        high[k] = grids[k][-1]


def limit_radius(design: Design, low: Floats, high: Floats, outer_radius: float, wall: float) -> None:
    """Lower the upper bound of the inner radius so that gap and wall fit within the outer radius, in place."""
    min_radius = low[0] + low[2] + wall
    if min_radius > outer_radius * (1 + 1e-9):
        given = Words(f"{format_mm(outer_radius)}{'' if design.limits.outer_radius else ', as it is left out'}")
        raise InputError("limits.outer_radius", given, f"above {format_mm(min_radius)}: inner block, gap and wall need as much")
    high[0] = max(low[0], min(high[0], outer_radius - low[2] - wall))


def format_value(k: int, value: float) -> Any:
    """Return variable k with its unit, as a design file writes it."""
    return f"{value:g}" if k == 1 else (MODULUS_QUANTITY if k in MODULUS_INDICES else LENGTH_QUANTITY).format_value(value)
