"""Design files for tests of the search."""

from __future__ import annotations

from typing import Any

from geometry.scenes.scene import Scene
from probe_design.data.builtin import read_typical_scenes
from probe_design.design_search.search_space import SearchSpace, build_search_space
from probe_design.populations.design_file import Design, design_from_dict
from probe_design.populations.tables import DesignLimits


def design(units_required: bool = False, **tables: Any) -> Design:
    """Return a design file round a usual probe; numbers are in SI units unless texts are required."""
    return design_from_dict({"scene": read_typical_scenes()["on-axis"], **tables}, units_required=units_required)


def build_space(scene: Scene, outer_radius: float | None = None) -> SearchSpace:
    """Return the designs around a scene's probe up to an outer radius."""
    return build_search_space(Design.model_construct(scene=scene, limits=DesignLimits.model_construct(outer_radius=outer_radius)))
