"""Compute reference solutions for a spheroid on the probe's axis, diameters [a, a, c], by NGSolve.

The problem and its discretisation are those of ``axisymmetric``; only the mesh differs: the sphere's two quarter
circles become quarters of an ellipse, which netgen's rational splines are exactly and along which it grades the mesh by
curvature. ``relative_uncertainty`` is the largest change from the first of ``MESHES`` to the second, which gives the values.

Usage: ``python -m benchmarks.references.spheroids FOLDER``; writes the folder's ``expected.json``

Duration: minutes.
"""

from __future__ import annotations

import json
import math
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import ngsolve as ngs
import numpy as np

from benchmarks.references import outline as reference_outline
from benchmarks.references.axisymmetric import LADDER, ReferenceAnswer, difference, entry, solve
from benchmarks.references.outline import Edge, Refinement, build_mesh
from geometry import Inclusion, Scene, read_scene

MESHES = LADDER[-2:]
SAMPLES = np.linspace(0.0, 1.0, 200)[:, None]  # parameters of the points that stand for an arc in ``Arc.distance``

Point = tuple[float, float]


class Arc(Edge):
    """A quarter of an ellipse about ``centre``, between a pole and the equator; ``Edge.point`` holds for it too."""

    def distance(self, p: np.ndarray) -> float:
        """Distance of a point from the edge, within the spacing of ``SAMPLES``."""
        centre, angle = np.array([0.0, self.centre]), SAMPLES * math.pi / 2
        points = centre + np.cos(angle) * (np.array(self.start) - centre) + np.sin(angle) * (np.array(self.end) - centre)
        return float(np.hypot(*(points - p).T).min())


def semi_axes(body: Inclusion) -> Point:
    """Return the radii of equator and pole.

    Raises
    ------
    ValueError
        The body is not a spheroid about a vertical axis.
    """
    if body.diameters is None or body.diameters[0] != body.diameters[1] or any(body.orientation):
        raise ValueError("the reference takes one inclusion with diameters [a, a, c] that is not turned")
    return body.diameters[0] / 2, body.diameters[2] / 2


def outline(scene: Scene) -> list[Edge]:
    """Return the meridian plane's edges: those with a sphere as high as the spheroid, the sphere's stretched sideways."""
    (body,) = scene.inclusion
    equator, pole = semi_axes(body)
    sphere = body.model_copy(update={"diameter": 2 * pole, "diameters": None})
    edges = reference_outline.outline(scene.model_copy(update={"inclusion": (sphere,)}))
    return [edge if edge.centre is None else stretch_arc(edge, equator / pole) for edge in edges]


def stretch_arc(edge: Edge, factor: float) -> Arc:
    """Return a quarter circle with every distance from the axis times a factor."""
    start, end = ((r * factor, z) for r, z in (edge.start, edge.end))
    return Arc(start, end, edge.left, edge.right, edge.name, edge.centre)


def make_mesh(scene: Scene, refinement: Refinement) -> ngs.Mesh:
    """Build the mesh of the spheroid's outline."""
    return build_mesh(outline(scene), refinement)


def reference(scene: Scene) -> ReferenceAnswer:
    """Solve on both meshes."""
    start = time.perf_counter()
    coarse, fine = (solve(scene, refinement, make_mesh) for refinement in MESHES)
    return replace(fine, relative_uncertainty=max(difference(coarse, fine), 1e-9), seconds=time.perf_counter() - start)


def main(folder: Path) -> None:
    """Print one JSON object per scene and write ``expected.json``."""
    ngs.SetNumThreads(1)
    entries = {}
    for path in sorted(folder.glob("*.toml")):
        answer = reference(read_scene(path))
        entries[path.stem] = entry(answer)
        print(json.dumps({"scene": path.stem} | asdict(answer)), flush=True)
    (folder / "expected.json").write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
