"""Small scenes of a kind."""

from __future__ import annotations

from typing import Any

from geometry import Scene, read_scene, scene_from_dict
from tests.support.paths import SCENE


def block_scene(**changes: Any) -> Scene:
    """A small scene that needs three dimensions: a grooved probe on a block of tissue, a tumour beside its axis."""
    soft = {"youngs_modulus": "6 kPa", "poisson_ratio": 0.45}
    block = {"youngs_modulus": "1 MPa", "poisson_ratio": 0.48}
    tables = {
        "probe": {
            "inner_radius": "4 mm", "area_ratio": 1.2, "gap": "0.1 mm", "height": "3 mm", "inner": block, "outer": block,
            "base": {"rigid": True}, "groove": {"width": "2 mm", "depth": "1 mm"},
        },
        "tissue": {"shape": "block", "length": "60 mm", "breadth": "50 mm", "depth": "40 mm", **soft},
        "inclusion": [{"diameter": "8 mm", "depth": "7 mm", "x": "3 mm", **soft}],
        "load": {"indentation": "3 um"},
    }  # fmt: skip
    tables.update(changes)
    return scene_from_dict(tables)


def nodule() -> Scene:
    """A probe of 4 mm on a nodule of 5 mm, 3 mm deep: on it a tighter limit of the radius once gave a better optimum."""
    scene = read_scene(SCENE)
    data = scene.model_dump(exclude_unset=True)
    data["probe"] = data["probe"] | {"inner_radius": 2e-3, "outer_radius": 4e-3}
    del data["probe"]["area_ratio"]
    data["inclusion"] = ({**data["inclusion"][0], "diameter": 5e-3, "depth": 3e-3},)
    return Scene.model_validate(data)
