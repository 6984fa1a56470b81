"""Cases of `benchmarks.readings.intervals`: probes and tissues of the examples, at loads within linear elasticity."""

from __future__ import annotations

from pathlib import Path

from benchmarks.readings.truths import Press, ReadingCase
from geometry import read_scene
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load

EXAMPLES = Path(__file__).parents[2] / "examples"
LIGHT_LOAD = Load(force=5e-4)  # N: finite strain is nothing beside the noise
SCAN_PRESSES = tuple(Press(x) for x in (-10e-3, -5e-3, 0.0, 5e-3, 10e-3))


def _example(name: str) -> Scene:
    return read_scene(EXAMPLES / name).model_copy(update={"load": LIGHT_LOAD})


def cases() -> tuple[ReadingCase, ...]:
    """Return the cases in the order of the table."""
    plain, skin = _example("scene.toml"), _example("skin.toml")
    blank = (Press(), Press(blank=True))
    single, nuisance_blank, scan, layers = "one unknown", "two nuisances, blank", "scan", "layers"
    tissue, thickness = "tissue.youngs_modulus", "tissue.layer[0].thickness"
    return (
        ReadingCase(single, "modulus, 1 %", plain, "youngs_modulus", 0.6e3, 600e3, 0.01),
        ReadingCase(single, "modulus, 5 %", plain, "youngs_modulus", 0.6e3, 600e3, 0.05),
        ReadingCase(single, "diameter, 2 %", plain, "diameter", 2e-3, 17e-3, 0.02),
        ReadingCase(single, "depth, 2 %", plain, "depth", 4.5e-3, 40e-3, 0.02),
        ReadingCase(nuisance_blank, "skin and fat, 1 %", skin, "youngs_modulus", 1e3, 1e6, 0.01, blank,
             nuisances={thickness: 0.15, tissue: 0.2}),
        ReadingCase(nuisance_blank, "skin and fat, with stiffness, 2 %", skin, "youngs_modulus", 1e3, 1e6, 0.02,
             (Press(stiff=True), Press(blank=True, stiff=True)), nuisances={thickness: 0.15, tissue: 0.2}),
        ReadingCase(nuisance_blank, "depth and tissue, 1 %", plain, "youngs_modulus", 0.6e3, 600e3, 0.01, blank, nodes=(24, 6),
             nuisances={"inclusion.depth": 0.1, tissue: 0.2}),
        ReadingCase(
            scan, "depth, 2 %", plain, "depth", 5.5e-3, 22e-3, 0.02, SCAN_PRESSES, evaluator="solid", accuracy=0.005, nodes=(9, 0)
        ),
        ReadingCase(layers, "skin's thickness, 2 %", skin, thickness, 0.3e-3, 4.5e-3, 0.02, (Press(blank=True),), nodes=(20, 0)),
        ReadingCase(layers, "skin's modulus, with stiffness, 2 %", skin, "tissue.layer[0].youngs_modulus", 10e3, 400e3, 0.02,
             (Press(blank=True, stiff=True),), nodes=(20, 0)),
        ReadingCase(layers, "skin's thickness, fat roughly, 2 %", skin, thickness, 0.4e-3, 4.5e-3, 0.02,
             (Press(blank=True, stiff=True),), nuisances={tissue: 0.2}, nodes=(16, 7)),
    )  # fmt: skip
