"""Populations in a layered tissue."""

from __future__ import annotations

from dataclasses import replace

import pytest

from geometry import Scene, read_scene
from geometry.common.errors import InputError
from probe_design.locating import forward_model
from probe_design.locating.prior import TumourPrior
from tests.probe_design.locating.test_inference import PLACES, design
from tests.support.paths import ROOT


def test_tumours_in_two_layers_are_refused_with_the_depths_of_each() -> None:
    """Within the upper 10 mm the largest reach down to 10 mm - 2.5 mm - a tenth of 5 mm."""
    layer = {"thickness": 10e-3, "youngs_modulus": 4e3, "poisson_ratio": 0.45}
    scene = read_scene(ROOT / "examples" / "scene.toml")
    layered = Scene.from_tables(scene.model_dump(exclude_none=True) | {"tissue": scene.tissue.model_dump() | {"layer": [layer]}})
    prior = replace(TumourPrior.from_design(design(depth=[4e-3, 20e-3], diameter=[3e-3, 5e-3]), PLACES), scene=layered)
    with pytest.raises(InputError, match=r"population.depth = 4 mm to 20 mm: .* up to 7 mm, or from 11.8 mm on"):
        forward_model.build_models(prior, (layered,))
