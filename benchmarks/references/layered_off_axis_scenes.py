"""Make the scenes of ``tests/reference/tissue-layers-off-axis``: off-axis tumours in layered tissue.

Usage: ``python -m benchmarks.references.layered_off_axis_scenes FOLDER``, then ``python -m benchmarks.references.solid FOLDER``
for the results.

Duration: seconds.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from benchmarks.references.layered_scenes import SKIN, Layer, scene, write
from geometry import Scene

TISSUE = {"shape": "cylinder", "radius": 30e-3, "depth": 30e-3}
OUTER_RADIUS = scene().probe.tube_radius
FAT, GROUND = (8e-3, 3e3, 0.45), (12e3, 0.45)


def build_off_axis_scene(
    bodies: list[dict[str, Any]], *layers: Layer, ground: tuple[float, float] = (6e3, 0.45), **changes: Any
) -> Scene:
    """Return the example with other tumours on smaller tissue of layers."""
    tumours = [{"poisson_ratio": 0.45} | body for body in bodies]
    layered = scene(*layers, ground=ground, **changes).model_dump(exclude_unset=True)
    return Scene.model_validate(layered | {"tissue": layered["tissue"] | TISSUE, "inclusion": tumours})


def sphere(x: float, depth: float, youngs_modulus: float = 30e3, diameter: float = 8e-3, **options: Any) -> dict[str, Any]:
    """Return a tumour; ``x`` in outer radii."""
    return {"diameter": diameter, "x": x * OUTER_RADIUS, "depth": depth, "youngs_modulus": youngs_modulus} | options


SCENES = {
    "skin": build_off_axis_scene([sphere(0.5, 9e-3)], (1.5e-3, 56e3, 0.45)),
    "two-tumours-frictionless": build_off_axis_scene(
        [sphere(0.5, 5.2e-3, diameter=6e-3, target=True), sphere(-1.0, 14.5e-3, youngs_modulus=100e3)],
        *(SKIN, FAT),
        ground=GROUND,
        contact={"interface": "frictionless"},
    ),
    "across": build_off_axis_scene([sphere(0.7, 9e-3, youngs_modulus=50e3)], SKIN, FAT, ground=GROUND),
}


if __name__ == "__main__":
    write(Path(sys.argv[1]), SCENES)
