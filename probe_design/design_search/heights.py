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
from geometry.scenes.units import SI
from probe_design.optimisation.design_space import CLOSE, HEIGHTS, VARIABLES, Limit, Space, variables

INNER, OUTER = 3, 6  # where the heights are
APART = (*VARIABLES[:INNER], "inner_height", *VARIABLES[INNER + 1 :], "outer_height")
GROOVED = 1.25  # depths of the groove that a block of its own height is high at least


def names(apart: bool) -> tuple[str, ...]:
    """Return the names of the six or seven design variables in order."""
    return APART if apart else VARIABLES


def heights_differ(scene: Scene) -> bool:
    """Return whether the two blocks of a scene's probe have different heights."""
    return scene.probe.core_height != scene.probe.tube_height


def design_of(scene: Scene, apart: bool | None = None) -> Floats:
    """Return the design of a scene's probe, SI, shape (6,) or (7,); ``apart`` left out: as its heights say."""
    seventh = heights_differ(scene) if apart is None else apart
    return np.append(variables(scene), [scene.probe.tube_height] if seventh else [])


def outer_height(x: Any) -> Any:
    """Return the outer block's height of designs x (variables first)."""
    return x[OUTER] if len(x) > OUTER else x[INNER]


def with_heights(scene: Scene, inner: float, outer: float) -> Scene:
    """Return a scene whose blocks have these heights, m; raises ``ValueError`` where that breaks a rule."""
    probe = scene.probe.model_dump(exclude={"height", "inner_height", "outer_height"}, exclude_unset=True)
    probe |= {"inner_height": inner, "outer_height": outer}
    return Scene.model_validate(scene.model_dump(exclude_unset=True) | {"probe": probe}, context=SI)


@dataclass(frozen=True)
class SteppedSpace(Space):
    """A design space of seven variables, with a separate height for each block."""

    def scene_of(self, x: Floats) -> Scene | None:
        """See ``Space.build_scene``; both heights are rounded as lengths are."""
        made = super().scene_of(x[:OUTER])
        try:
            return None if made is None else with_heights(made, round(float(x[INNER]), 5), round(float(x[OUTER]), 5))
        except ValueError:
            return None

    def limits(self, scene: Scene) -> tuple[Limit, ...]:
        """See ``Space.list_limits``."""
        rows = [replace(one, name=one.name.replace(" height", " inner_height")) for one in super().limits(scene)]
        at = scene.probe.tube_height
        for word, limit in (("least", self.low[OUTER]), ("largest", self.high[OUTER])):
            rows.append(Limit(f"{word} outer_height", float(limit), bool(abs(at - limit) <= CLOSE * limit)))
        return tuple(rows)


def stepped(space: Space) -> SteppedSpace:
    """Return the space with a separate height for each block; the outer block's lower bound leaves room for the groove."""
    scene, groove = space.scene, space.scene.probe.groove
    outer, low = scene.probe.tube_height, space.low.copy()
    low[INNER] = min(HEIGHTS[0], scene.probe.core_height)
    least = max(min(HEIGHTS[0], outer), GROOVED * groove.depth if groove else 0.0)
    both = np.append(low, least), np.append(space.high, max(HEIGHTS[1], outer))
    return SteppedSpace(scene, *both, space.outer_radius, space.wall)


def of_one_height(space: Space) -> Space:
    """Return the space without the seventh variable."""
    return Space(space.scene, space.low[:OUTER], space.high[:OUTER], space.outer_radius, space.wall)
