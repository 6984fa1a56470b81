"""Bounds of the design variables: from the design file, then narrowed by its limits."""

from __future__ import annotations

import math
from typing import Any

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.probe import LENGTH, mm
from geometry.scenes.units import MODULUS
from probe_design.design_search.heights import INNER, OUTER, heights_differ, names, stepped
from probe_design.optimisation.design_space import Space, space
from probe_design.populations.design_file import Design
from probe_design.populations.variables import DesignVariable

MODULI = (4, 5)  # where those of inner and outer block are
MOST_STEPS = 10_000


def usual_space(design: Design) -> Space:
    """Return the default bounds around the start, within the limit of the outer radius; raise ``InputError`` if none are left."""
    try:
        found = space(design.scene, design.limits.outer_radius)
    except InputError as fault:
        raise InputError("limits.outer_radius", fault.value, fault.allowed) from None
    return stepped(found) if _apart(design) else found


def _apart(design: Design) -> bool:
    """Return whether the two blocks have separate heights: the file gives them, or gives none and the start's heights differ.

    Raises:
        InputError: the file gives both kinds of height, or fixes one common height although the start has two.
    """
    height, own, differ = design.variables.height, design.variables.of_heights, heights_differ(design.scene)
    if own and height != DesignVariable():
        raise InputError("variables.height", "given", f"nothing beside {' and '.join(own)}, in whose place it stands")
    if height.fixed and differ:
        raise InputError("variables.height", "fixed", "inner_height and outer_height, as the start's blocks differ in height")
    return bool(own) or (differ and height == DesignVariable())


def ends(name: str, variable: DesignVariable, low: float, high: float, start: float) -> tuple[float, float, tuple[float, ...]]:
    """Return the lower and upper bound of a variable and its discrete values, which are empty if it is continuous."""
    if variable.fixed:
        return start, start, ()
    if variable.choices:
        return variable.choices[0], variable.choices[-1], variable.choices
    low, high = (low if variable.low is None else variable.low), (high if variable.high is None else variable.high)
    return low, high, () if variable.step is None else _steps(name, variable.step, low, high)


def _steps(name: str, step: float, low: float, high: float) -> tuple[float, ...]:
    """Return the multiples of a step that lie between the bounds."""
    k = names(apart=True).index(name) if name != "height" else INNER
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    if last - first >= MOST_STEPS or last < first:
        few = "wide enough for at most 10000 values" if last >= first else "with a multiple between the bounds"
        raise InputError(f"variables.{name}.step", shown(k, step), f"a step {few} of {shown(k, low)} to {shown(k, high)}")
    return tuple(float(f"{n * step:.12g}") for n in range(first, last + 1))


def limit_height(design: Design, k: int, low: Floats, high: Floats, *, grids: dict[int, tuple[float, ...]]) -> None:
    """Lower the upper bound and the grid of height variable k to the limit of heights, in place."""
    limit = design.limits.height
    if limit is None:
        return
    if low[k] > limit:
        if getattr(design.variables, names(len(low) > OUTER)[k]) == DesignVariable() and design.scene.probe.groove is None:
            low[k] = limit  # the start is higher: no bound that was asked for
        else:
            raise InputError("limits.height", mm(limit), f"at least {mm(low[k])}, the least height of the blocks")
    high[k] = max(low[k], min(high[k], limit))
    if k in grids:
        grids[k] = tuple(value for value in grids[k] if value <= limit * (1 + 1e-9))
        if not grids[k]:
            raise InputError("limits.height", mm(limit), "a limit that leaves one of the heights that step or choices allow")
        high[k] = grids[k][-1]


def limit_radius(design: Design, low: Floats, high: Floats, outer_radius: float, wall: float) -> None:
    """Lower the upper bound of the inner radius so that gap and wall fit within the outer radius, in place."""
    least = low[0] + low[2] + wall
    if least > outer_radius * (1 + 1e-9):
        given = Words(f"{mm(outer_radius)}{'' if design.limits.outer_radius else ', as it is left out'}")
        raise InputError("limits.outer_radius", given, f"above {mm(least)}: inner block, gap and wall need as much")
    high[0] = max(low[0], min(high[0], outer_radius - low[2] - wall))


def shown(k: int, value: float) -> Any:
    """Return variable k with its unit, as a design file writes it."""
    return f"{value:g}" if k == 1 else (MODULUS if k in MODULI else LENGTH).text(value)
