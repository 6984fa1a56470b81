"""Compare ``solid`` with converged results of independent codes: true and stated errors, seconds, sizes.

Usage: ``python -m benchmarks.evaluators.solid_references [--accuracy 0.01] [--folder solid ...] [--name flank]``;
about half a minute per scene. Meshes come from the cache where they were made before (``PROBE_DESIGN_CACHE``).

Duration: half a minute per scene.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter
from typing import Any

from rich.console import Console

from benchmarks.tables import MeasuredTable
from geometry import Refusal, Scene, read_scene
from geometry.common.errors import SolveError
from solver.solid.evaluator import SolidEvaluator

REFERENCE = Path(__file__).parents[2] / "tests" / "reference"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--accuracy", type=float, default=0.01)
    parser.add_argument("--folder", action="append", help="of tests/reference (solid)")
    parser.add_argument("--name", action="append", help="only scenes of this name")
    given = parser.parse_args()
    headings = (
        "scene",
        "true, error",
        "stated, error",
        "reference's, error",
        "stiffness, error",
        "log-sensitivity, error",
        "unknowns, count",
        "tetrahedra, count",
        "all, s",
    )
    table = MeasuredTable(f"solid at accuracy {given.accuracy:g}: relative errors", headings)
    for name, scene, known in scenes(given.folder or ["solid"], given.name):
        print(f"{name} ...", file=sys.stderr, flush=True)
        table.add(name, *row(scene, known, given.accuracy))
    table.note("stiffness and log-sensitivity: true errors; a dash where the reference says nothing")
    table.print(Console(width=150))


def scenes(folders: list[str], names: list[str] | None) -> Iterator[tuple[str, Scene, dict[str, float]]]:
    for folder in folders:
        for name, known in json.loads((REFERENCE / folder / "expected.json").read_text()).items():
            if names is None or name in names:
                yield name, read_scene(REFERENCE / folder / f"{name}.toml"), known


def row(scene: Scene, known: dict[str, float], accuracy: float) -> Iterator[Any]:
    start = perf_counter()
    try:
        level = SolidEvaluator()
        forces = level.solve_forces(scene, accuracy)
        result = level.build_solution(scene, forces, accuracy).build_result(level.name, scene, 0.0)
    except (Refusal, SolveError) as fault:
        print(f"refused: {fault}", file=sys.stderr)
        yield from [None] * 8
        return
    yield math.nan if result.ratio is None else abs(result.ratio / known["ratio"] - 1)
    yield result.error_estimate
    yield known["relative_uncertainty"]
    yield None if result.stiffness is None else abs(result.stiffness / known["stiffness_n_per_m"] - 1)
    true_slope = known.get("log_sensitivity")
    yield None if not true_slope or result.log_sensitivity is None else abs(result.log_sensitivity / true_slope - 1)
    yield forces.difference.unknowns
    yield len(forces.states.problem.solid.elements)
    yield perf_counter() - start


if __name__ == "__main__":
    main()
