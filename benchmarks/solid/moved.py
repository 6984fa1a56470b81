"""Compare moved meshes with converged results of independent codes: true and stated errors.

Usage: ``python -m benchmarks.solid.moved [--folder off-axis ...] [--name NAME ...] [--by 0.25]``; some ten seconds a scene. Each
reference is evaluated after a scene whose first tumour lay elsewhere, by a share ``--by`` of its least radius: deeper, shallower
where that leaves the tissue, and aside, all from an empty cache of meshes.

Duration: ten seconds per scene.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.evaluators.solid_references import scenes
from benchmarks.solid.changes import processor, replace_first
from benchmarks.tables import MeasuredTable
from geometry import Refusal, Scene
from geometry.common.cached_arrays import CACHE_VARIABLE
from geometry.common.errors import InputError
from geometry.common.resources import Limits, use_limits
from solver.linalg.workspace import Workspace
from solver.solid.evaluator import SolidEvaluator

COLUMNS = ("scene", "from", "true, error", "stated, error", "log-sensitivity, error", "processor, s", "meshes")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--accuracy", type=float, default=0.01)
    parser.add_argument("--folder", action="append", help="of tests/reference (solid and off-axis)")
    parser.add_argument("--name", action="append", help="only scenes of this name")
    parser.add_argument("--by", type=float, default=0.25, help="share of the first tumour's least radius that it moves (0.25)")
    given = parser.parse_args()
    table = MeasuredTable(f"meshes moved, at accuracy {given.accuracy:g}", COLUMNS)
    for name, scene, known in scenes(given.folder or ["solid", "off-axis"], given.name):
        for what, start in starts(scene, given.by):
            print(f"{name} from {what} ...", file=sys.stderr, flush=True)
            cells = list(row(scene, start, known, given.accuracy))
            print(*cells, file=sys.stderr, flush=True)
            table.add(name, what, *cells)
    table.print(Console(width=150))


def starts(scene: Scene, offset: float) -> Iterator[tuple[str, Scene]]:
    """Scenes whose first tumour lies elsewhere."""
    body = scene.inclusion[0]
    step = offset * min(body.diameters or (body.diameter or 0.0,)) / 2
    for what, place in (
        ("above", {"depth": body.depth - step}),
        ("below", {"depth": body.depth + step}),
        ("aside", {"x": body.x + step}),
    ):
        try:
            yield what, Scene.model_validate(replace_first(scene, **place).model_dump())
        except (InputError, Refusal, ValueError):  # no room for it there
            continue


def row(scene: Scene, start: Scene, known: dict[str, float], accuracy: float) -> Iterator[Any]:
    with tempfile.TemporaryDirectory() as empty, use_limits(Limits(seconds=3600.0)):
        os.environ[CACHE_VARIABLE] = empty
        level = SolidEvaluator(workspace=Workspace())
        try:
            level.evaluate(start, accuracy)
        except Refusal as fault:
            print(f"refused: {fault}", file=sys.stderr)
            yield from [None] * 5
            return
        made, start_seconds = len(list(Path(empty).iterdir())), processor()
        result = level.evaluate(scene, accuracy)
        seconds = processor() - start_seconds
        added = len(list(Path(empty).iterdir())) - made
    yield abs((result.ratio or 0.0) / known["ratio"] - 1)
    yield result.error_estimate
    true_slope = known.get("log_sensitivity")
    yield None if not true_slope or result.log_sensitivity is None else abs(result.log_sensitivity / true_slope - 1)
    yield seconds
    yield "moved" if not added else f"{added} made"


if __name__ == "__main__":
    main()
