"""A small probe over a shallow nodule: the scene on which a tighter limit of the radius once gave a better optimum."""

from __future__ import annotations

from geometry import Scene, read_scene
from tests.support.paths import SCENE


def nodule() -> Scene:
    """A probe of 4 mm on a nodule of 5 mm, 3 mm deep, in the tissue of examples/scene.toml."""
    scene = read_scene(SCENE)
    data = scene.model_dump(exclude_unset=True)
    data["probe"] = data["probe"] | {"inner_radius": 2e-3, "outer_radius": 4e-3}
    del data["probe"]["area_ratio"]
    data["inclusion"] = ({**data["inclusion"][0], "diameter": 5e-3, "depth": 3e-3},)
    return Scene.model_validate(data)
