"""Compute reference solutions on a half-space: NGSolve on growing cylinders of tissue, extrapolated to an infinite one.

A cylinder as deep as its radius R reflects the probe's field back on it; far away the field is a series of multipoles, so
the film forces are a power series in 1/R. Neville's scheme takes it to 1/R = 0 from radii of ``REACHES`` times the reach of
probe and inclusion, halved from each to the next. ``relative_uncertainty`` is the larger of what the largest cylinder
changes and what a finer mesh changes.

Usage: ``python -m benchmarks.references.half_space FOLDER``; writes the folder's ``expected.json``

Duration: minutes.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import ngsolve as ngs
import numpy as np

from benchmarks.references.axisymmetric import LADDER, ReferenceAnswer, difference, entry, film_forces, summary
from benchmarks.references.outline import Refinement
from geometry import CylinderTissue, Scene, read_scene

REACHES = (8.0, 16.0, 32.0, 64.0, 128.0, 256.0)


def bound_tissue(scene: Scene, reach: float) -> Scene:
    """Return the scene with a cylinder of tissue as deep as its radius."""
    far = max([scene.probe.tube_radius, *(body.depth + (body.diameter or 0.0) / 2 for body in scene.inclusion)])
    size: dict[str, Any] = {"radius": reach * far, "depth": reach * far}
    moduli: dict[str, Any] = {"youngs_modulus": scene.tissue.youngs_modulus, "poisson_ratio": scene.tissue.poisson_ratio}
    return scene.model_copy(update={"tissue": CylinderTissue(shape="cylinder", **size, **moduli)})


def endless(values: list[np.ndarray]) -> np.ndarray:
    """Extrapolate values at the end of ``REACHES`` to infinite reach: Neville's scheme in 1/R for radii that double."""
    column = values
    for power in range(1, len(values)):
        column = [b + (b - a) / (2**power - 1) for a, b in pairwise(column)]
    return column[0]


def extrapolate_results(scene: Scene, refinement: Refinement) -> tuple[ReferenceAnswer, ReferenceAnswer]:
    """Return the results on the half-space without and with the largest cylinder."""
    forces = [np.array(film_forces(bound_tissue(scene, reach), refinement)) for reach in REACHES]
    return summary(scene, *endless(forces[:-1])), summary(scene, *endless(forces))


def reference(scene: Scene) -> ReferenceAnswer:
    """Extrapolate on two refinements."""
    start = time.perf_counter()
    (_, coarse), (smaller, fine) = (extrapolate_results(scene, refinement) for refinement in LADDER[-2:])
    uncertainty = max(difference(coarse, fine), difference(smaller, fine), 1e-9)
    return replace(fine, relative_uncertainty=uncertainty, seconds=time.perf_counter() - start)


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
