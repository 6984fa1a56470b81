"""Design vectors with one common height, or with a separate height for each block as a seventh variable.

A design x is (6,) in the order of ``design_space.VARIABLES`` where both blocks have one height, and (7,) where they differ: the
fourth is the inner block's then, the seventh the outer's. The base carries the step between them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from geometry.scenes.units import SI_CONTEXT
from probe_design.optimisation.design_space import (
    HEIGHT_BOUNDS_M,
    SAME_DESIGN_TOLERANCE_RELATIVE,
    VARIABLES,
    Limit,
    Space,
    read_variables,
)

INNER_HEIGHT_INDEX, OUTER_HEIGHT_INDEX = 3, 6  # where the heights are
SEPARATE_HEIGHT_VARIABLES = (
    *VARIABLES[:INNER_HEIGHT_INDEX],
    "inner_height",
    *VARIABLES[INNER_HEIGHT_INDEX + 1 :],
    "outer_height",
)
MIN_HEIGHT_PER_GROOVE_DEPTH = 1.25  # depths of the groove that a block of its own height is high at least


def variable_names(separate_heights: bool) -> tuple[str, ...]:
    """Return the names of the six or seven design variables in order."""
    return SEPARATE_HEIGHT_VARIABLES if separate_heights else VARIABLES


def has_different_heights(scene: Scene) -> bool:
    """Return whether the two blocks of a scene's probe have different heights."""
    return scene.probe.core_height != scene.probe.tube_height


def read_design_vector(scene: Scene, separate_heights: bool | None = None) -> Floats:
    """Return the design of a scene's probe, SI, shape (6,) or (7,); by default its heights decide on ``separate_heights``."""
    seventh = has_different_heights(scene) if separate_heights is None else separate_heights
    return np.append(read_variables(scene), [scene.probe.tube_height] if seventh else [])


def get_outer_height(x: Any) -> Any:
    """Return the outer block's height of designs x (variables first)."""
    return x[OUTER_HEIGHT_INDEX] if len(x) > OUTER_HEIGHT_INDEX else x[INNER_HEIGHT_INDEX]


def set_heights(scene: Scene, inner: float, outer: float) -> Scene:
    """Return a scene whose blocks have these heights, m; raises ``ValueError`` where that breaks a rule."""
    probe = scene.probe.model_dump(exclude={"height", "inner_height", "outer_height"}, exclude_unset=True)
    probe |= {"inner_height": inner, "outer_height": outer}
    return Scene.model_validate(scene.model_dump(exclude_unset=True) | {"probe": probe}, context=SI_CONTEXT)


@dataclass(frozen=True)
class SeparateHeightsSpace(Space):
    """A design space of seven variables, with a separate height for each block."""

    def build_scene(self, x: Floats) -> Scene | None:
        """See ``Space.build_scene``; both heights are rounded as lengths are."""
        made = super().build_scene(x[:OUTER_HEIGHT_INDEX])
        try:
            return (
                None
                if made is None
                else set_heights(made, round(float(x[INNER_HEIGHT_INDEX]), 5), round(float(x[OUTER_HEIGHT_INDEX]), 5))
            )
        except ValueError:
            return None

    def list_limits(self, scene: Scene) -> tuple[Limit, ...]:
        """See ``Space.list_limits``."""
        rows = [replace(row, name=row.name.replace(" height", " inner_height")) for row in super().list_limits(scene)]
        outer_height_m = scene.probe.tube_height
        for word, limit in (("least", self.low[OUTER_HEIGHT_INDEX]), ("largest", self.high[OUTER_HEIGHT_INDEX])):
            rows.append(
                Limit(
                    f"{word} outer_height",
                    float(limit),
                    bool(abs(outer_height_m - limit) <= SAME_DESIGN_TOLERANCE_RELATIVE * limit),
                )
            )
        return tuple(rows)


def build_separate_heights_space(space: Space) -> SeparateHeightsSpace:
    """Return the space with a separate height for each block; the outer block's lower bound leaves room for the groove."""
    scene, groove = space.scene, space.scene.probe.groove
    outer, low = scene.probe.tube_height, space.low.copy()
    low[INNER_HEIGHT_INDEX] = min(HEIGHT_BOUNDS_M[0], scene.probe.core_height)
    min_outer_height = max(min(HEIGHT_BOUNDS_M[0], outer), MIN_HEIGHT_PER_GROOVE_DEPTH * groove.depth if groove else 0.0)
    bounds = np.append(low, min_outer_height), np.append(space.high, max(HEIGHT_BOUNDS_M[1], outer))
    return SeparateHeightsSpace(scene, *bounds, space.outer_radius, space.wall)


def drop_outer_height(space: Space) -> Space:
    """Return the space without the seventh variable."""
    return Space(space.scene, space.low[:OUTER_HEIGHT_INDEX], space.high[:OUTER_HEIGHT_INDEX], space.outer_radius, space.wall)
