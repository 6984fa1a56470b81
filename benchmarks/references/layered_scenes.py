"""Make the scenes of ``tests/reference/tissue-layers``: the probe of examples/scene.toml on layered tissue.

Usage: ``python -m benchmarks.references.layered_scenes FOLDER``, then ``python -m benchmarks.references.axisymmetric FOLDER``
for the results.

Duration: seconds.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from geometry import Scene, read_scene
from geometry.scenes.scene_file import scene_to_toml

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "scene.toml"
SKIN = (1.44e-3, 56.3e3, 0.45)  # thickness m, Young's modulus Pa, Poisson's ratio: the breast's in vivo
Layer = tuple[float, float, float]


def scene(*layers: Layer, ground: tuple[float, float] = (6e3, 0.45), **changes: Any) -> Scene:
    """Return the example on layers above a material of its own, (Young's modulus Pa, Poisson's ratio)."""
    base = read_scene(EXAMPLE).model_dump(exclude_unset=True)
    names = ("thickness", "youngs_modulus", "poisson_ratio")
    tissue = base["tissue"] | dict(zip(names[1:], ground, strict=True))
    tissue["layer"] = [dict(zip(names, layer, strict=True)) for layer in layers]
    return Scene.model_validate(base | {"tissue": tissue} | changes)


SCENES = {
    "breast": scene(SKIN, ground=(3.04e3, 0.45)),
    "skin-of-the-trial": scene((1.5e-3, 56e3, 0.45)),
    "thin-skin-of-the-trial": scene((0.5e-3, 12e3, 0.45)),
    "soft-skin": scene((1.5e-3, 1e3, 0.45)),
    "film-of-a-tenth-millimetre": scene((0.1e-3, 1e6, 0.45)),
    "three-layers": scene((1.4e-3, 56e3, 0.45), (3e-3, 2e3, 0.49), (8e-3, 20e3, 0.4)),
    "bone-below": scene((1.4e-3, 56e3, 0.45), (14e-3, 5e3, 0.45), ground=(1e9, 0.3)),
    "nearly-incompressible": scene((1.5e-3, 56e3, 0.4999), ground=(6e3, 0.4999)),
    "frictionless": scene(SKIN, contact={"interface": "frictionless"}),
    "sphere-across": scene((9.5e-3, 3e3, 0.45), ground=(12e3, 0.45)),
    "sphere-across-two": scene((1.2e-3, 30e3, 0.45), (5.5e-3, 3e3, 0.49), (4e-3, 60e3, 0.4), ground=(6e3, 0.45)),
    "plate-on-gel": scene((3e-3, 1e6, 0.45), ground=(1e3, 0.49)),
    "without-a-tumour": scene((2e-3, 30e3, 0.45), (2e-3, 3e3, 0.49), inclusion=()),
}


def write(folder: Path, scenes: dict[str, Scene]) -> None:
    """Write scene files by their names."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, layered in scenes.items():
        (folder / f"{name}.toml").write_text(scene_to_toml(layered), encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]), SCENES)
