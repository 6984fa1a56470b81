"""Compute with NGSolve how far the walls at the gap approach each other per indentation, independently of ``solver``.

Linear elasticity of the probe on its tissue without tumours, as ``benchmarks.references.axisymmetric`` solves it, both blocks
pressed alike. The radial displacements of both walls are taken at ``HEIGHT_COUNT`` even heights between the tissue and the lower
block's upper end, and again where the largest is. The value is that of the finer of two meshes, ``uncertainty`` its change from
the other; ``tests/reference/gap-walls.json`` is what it writes.

    python -m benchmarks.contact.gap_walls

Duration: minutes.
"""

from __future__ import annotations

import json

import ngsolve as ngs
import numpy as np

from benchmarks.references.axisymmetric import LADDER, ReferenceProblem
from benchmarks.references.outline import Refinement
from geometry import Scene, read_scene
from geometry.common.arrays import Floats
from tests.support.paths import REFERENCE

SCENES = (
    "contact/example", "contact/equal-blocks-6kpa", "contact/paper", "axisymmetric/shallow", "axisymmetric/nearly-incompressible",
    "axisymmetric/homogeneous", "extremes/gap-1-um-frictionless",
)  # fmt: skip
HEIGHT_COUNT, SHOWN_HEIGHT_COUNT = 401, 20  # looked at, and how many of these are written down
BLOCK_MARGIN_INNER_RADII = 1e-9  # inner radii into the blocks, where a point is of theirs


def compute_nearing(scene: Scene, refinement: Refinement) -> tuple[Floats, Floats]:
    """Return heights in inner radii, shape (n,), and by how much the walls near each other there per indentation."""
    probe, bare = scene.probe, scene.model_copy(update={"inclusion": ()})
    problem = ReferenceProblem(bare, refinement)
    radial = [state.components[problem.parts[2][1]] for state in problem.states()]
    top, hole = min(probe.core_height, probe.tube_height) / probe.inner_radius, probe.hole_radius / probe.inner_radius
    rough = np.linspace(0.0, top, HEIGHT_COUNT)[1:-1]
    nearest = _compute_gap_change(problem.mesh, radial, hole, rough)
    fine = rough[nearest.argmax()] + np.linspace(-1.0, 1.0, HEIGHT_COUNT) * top / (HEIGHT_COUNT - 1)
    heights = np.concatenate([rough, fine])
    order = np.argsort(heights)
    return heights[order], np.concatenate([nearest, _compute_gap_change(problem.mesh, radial, hole, fine)])[order]


def _compute_gap_change(mesh: ngs.Mesh, radial: list[ngs.GridFunction], hole: float, heights: Floats) -> Floats:
    def compute_displacement(radius: float, z: float) -> float:
        return float(sum(field(mesh(radius, z)) for field in radial))

    return np.array(
        [
            compute_displacement(1 - BLOCK_MARGIN_INNER_RADII, z) - compute_displacement(hole + BLOCK_MARGIN_INNER_RADII, z)
            for z in heights
        ]
    )


def main() -> None:
    """Write the reference."""
    expected = {}
    for name in SCENES:
        scene = read_scene(REFERENCE / f"{name}.toml")
        coarse, (heights, fine) = compute_nearing(scene, LADDER[0])[1].max(), compute_nearing(scene, LADDER[1])
        shown = np.linspace(0, len(heights) - 1, SHOWN_HEIGHT_COUNT, dtype=int)
        expected[name] = {
            "largest": float(fine.max()),
            "at": float(heights[fine.argmax()]),
            "uncertainty": float(abs(fine.max() - coarse)),
            "heights": heights[shown].round(12).tolist(),
            "nearing": fine[shown].round(12).tolist(),
        }
        print(name, expected[name]["largest"], expected[name]["uncertainty"], flush=True)
    (REFERENCE / "gap-walls.json").write_text(json.dumps(expected, indent=1) + "\n")


if __name__ == "__main__":
    main()
