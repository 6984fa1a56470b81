"""Design files that tests share."""

from __future__ import annotations

from typing import Any

from geometry.scenes.scene import Scene
from probe_design.populations.design_file import Design, design_from_dict
from probe_design.populations.examination import examine
from probe_design.populations.performance import Performance
from tests.support.paths import ROOT

SUPERFICIAL: dict[str, Any] = {"depth": ["5 mm", "12 mm"], "diameter": ["5 mm", "8 mm"], "object": ["15 kPa", "60 kPa"]}
THREE: dict[str, Any] = {"positions": ["-8 mm", "8 mm", 3], "stiffness": True}


def example_design(**tables: Any) -> Design:
    """Return a design round the example's scene."""
    return design_from_dict({"scene": "scene.toml", **tables}, ROOT / "examples", True)


def verify(scene: Scene, design: Design, samples: int | None = None) -> Performance:
    """Evaluate a probe as the verification of a search does, on tumours that the search did not use."""
    return examine(scene, design, samples=samples, unseen=True).evaluate_all_channels(design)
