"""Design files that tests share."""

from __future__ import annotations

from typing import Any

from probe_design.populations.design_file import Design, design_from_dict
from tests.support.paths import ROOT

SUPERFICIAL: dict[str, Any] = {"depth": ["5 mm", "12 mm"], "diameter": ["5 mm", "8 mm"], "object": ["15 kPa", "60 kPa"]}
THREE: dict[str, Any] = {"positions": ["-8 mm", "8 mm", 3], "stiffness": True}


def example_design(**tables: Any) -> Design:
    """Return a design round the example's scene."""
    return design_from_dict({"scene": "scene.toml", **tables}, ROOT / "examples", True)
