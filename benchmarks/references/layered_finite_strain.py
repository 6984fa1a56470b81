"""Make ``tests/reference/contact/layered.json``: what finite strain changes on tissue of two materials, by NGSolve.

As ``shallow_tissue``, whose law and meshes these are, on deep tissue with one layer.

Usage: ``python -m benchmarks.references.layered_finite_strain FILE``

Duration: an hour.
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import ngsolve as ngs

from benchmarks.references.shallow_tissue import EXAMPLE, LINEAR_INDENTATION, MESHES, VALUES, FiniteStrain
from geometry import CylinderTissue, Scene, read_scene
from geometry.scenes.scene_tables import Layer

DEPTH, WIDTH = 9.0, 54.0  # outer radii, of the tissue


@dataclass(frozen=True)
class LayeredCase:
    """A layer's thickness in outer radii, its modulus over that of what is below it, and the indentation in outer radii."""

    thickness: float
    stiffer: float
    indentation: float


CASES = tuple(
    LayeredCase(*base_case)
    for base_case in (
        (0.23, 9.3, 0.01),
        (0.23, 9.3, 0.03),
        (0.23, 100.0, 0.01),
        (0.6, 30.0, 0.01),
        (0.23, 0.2, 0.01),
        (0.5, 0.01, 0.005),
    )
)


def build_scene(case: LayeredCase) -> Scene:
    """Return the example, its sphere included, on a case's tissue, whose softer material is the example's."""
    scene = read_scene(EXAMPLE)
    unit, soft = scene.probe.tube_radius, scene.tissue.youngs_modulus
    base_modulus = soft * max(1.0, 1 / case.stiffer)
    nu = scene.tissue.poisson_ratio
    layer = Layer(thickness=case.thickness * unit, youngs_modulus=case.stiffer * base_modulus, poisson_ratio=nu)
    tissue = CylinderTissue(
        shape="cylinder", radius=WIDTH * unit, depth=DEPTH * unit, youngs_modulus=base_modulus, poisson_ratio=nu, layer=(layer,)
    )
    return scene.model_copy(update={"tissue": tissue})


def entry(case: LayeredCase) -> dict[str, float]:
    """Return a row: relative changes on the finer mesh, and what the last refinement changed of them."""
    entries = []
    for mesh in MESHES:
        scene = build_scene(case)
        problem, unit = FiniteStrain(scene, mesh), scene.probe.tube_radius / scene.probe.inner_radius
        problem.press(0.0, LINEAR_INDENTATION * unit)
        linear, small = problem.values(LINEAR_INDENTATION), problem.sensitivity()
        problem.press(LINEAR_INDENTATION * unit, case.indentation * unit)
        changes = problem.values(case.indentation) / linear - 1
        entries.append([*changes.tolist(), math.log(problem.sensitivity() / small)])
    difference = max(abs(a - b) for a, b in zip(*entries, strict=True))
    names = (*VALUES, "ln_sensitivity", "uncertainty")
    return asdict(case) | dict(zip(names, (round(value, 6) for value in (*entries[-1], difference)), strict=True))


def main(path: Path) -> None:
    """Write the file, one row a line."""
    ngs.SetNumThreads(1)
    rows = []
    for case in CASES:
        rows.append(json.dumps(entry(case)))
        print(rows[-1], flush=True)
    path.write_text("[\n" + ",\n".join(rows) + "\n]\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
