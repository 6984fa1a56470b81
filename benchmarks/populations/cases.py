"""Three populations: superficial, deep, and mixed under a skin, round the probe of ``examples/scene.toml``."""

from __future__ import annotations

from typing import Any

from geometry.scenes.scene_file import read_scene, scene_to_dict
from probe_design.populations.design_file import Design, design_from_dict

SKIN = {"thickness": "1.5 mm", "youngs_modulus": "40 kPa", "poisson_ratio": 0.48}
OBJECT = ["15 kPa", "60 kPa"]
CASES: dict[str, dict[str, Any]] = {
    "superficial": {"depth": ["3 mm", "10 mm"], "diameter": ["4 mm", "12 mm"], "object": OBJECT},
    "deep": {"depth": ["10 mm", "25 mm"], "diameter": ["6 mm", "18 mm"], "object": OBJECT},
    "mixed under a skin": {
        "depth": ["4 mm", "20 mm"], "diameter": ["5 mm", "15 mm"], "object": OBJECT, "tissue": ["4 kPa", "9 kPa"],
        "layer": [{"thickness": ["1 mm", "2 mm"], "modulus": ["20 kPa", "80 kPa"]}],
    },
}  # fmt: skip


def case(name: str, **tables: Any) -> Design:
    """Return one of the three as a design file; ratio and stiffness are both read unless ``protocol`` says otherwise."""
    scene = scene_to_dict(read_scene("examples/scene.toml"))
    if "layer" in CASES[name]:
        scene["tissue"]["layer"] = [SKIN]
    protocol = {"protocol": {"stiffness": True}}
    return design_from_dict({"scene": scene, "population": CASES[name], **protocol, **tables}, ".", True)
