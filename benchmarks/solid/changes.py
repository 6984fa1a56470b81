"""Measure the cost of a changed scene in ``solid``: evaluated alone, and after the scene from which it was changed.

Usage: ``python -m benchmarks.solid.changes [SCENE.toml] [--accuracy 0.01] [--cache FOLDER]``; some minutes. Meshes are made where
the folder, else an empty one for each result, has none. Seconds are the processor's, of the processes that mesh, too.

Duration: minutes.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from rich.console import Console

from benchmarks.tables import MeasuredTable
from geometry import Scene, read_scene
from geometry.common.cached_arrays import CACHE_VARIABLE
from geometry.common.resources import Limits, use_limits
from geometry.scenes.scene_tables import Layer
from solver.linalg.workspace import Workspace
from solver.results.result import Result
from solver.solid.evaluator import SolidEvaluator

SCENE = Path(__file__).parents[2] / "tests" / "reference" / "solid" / "flank.toml"
SKIN = Layer(thickness=1.5e-3, youngs_modulus=3e4, poisson_ratio=0.45)
COLUMNS = ("scene", "alone, processor, s", "after the first, processor, s", "apart, error", "stated, error", "peak, MB")


def changes(scene: Scene) -> Iterator[tuple[str, Scene]]:
    body, load = scene.inclusion[0], scene.load
    yield "another load", scene.model_copy(update={"load": load.model_copy(update={"indentation": 2e-6, "force": None})})
    yield "tumour 1.5 times as stiff", replace_first(scene, youngs_modulus=1.5 * body.youngs_modulus)
    tissue = scene.tissue.model_copy(update={"youngs_modulus": 1.5 * scene.tissue.youngs_modulus})
    yield "tissue 1.5 times as stiff", scene.model_copy(update={"tissue": tissue})
    yield "tumour 1 mm deeper", replace_first(scene, depth=body.depth + 1e-3)
    if body.diameter is not None:
        yield "tumour 0.9 times as large", replace_first(scene, diameter=0.9 * body.diameter)
    placement = scene.placement.model_copy(update={"x": scene.placement.x + 1e-3})
    yield "probe 1 mm aside", scene.model_copy(update={"placement": placement})
    if not scene.tissue.layer:
        yield "a skin added", add_skin(scene)


def iterate_skins(scene: Scene) -> Iterator[tuple[str, Scene]]:
    """Yield changes of a scene that has the skin of ``add_skin``."""
    yield "skin 1.5 times as stiff", add_skin(scene, modulus=1.5 * SKIN.youngs_modulus)
    yield "skin 0.2 mm thicker", add_skin(scene, thickness=SKIN.thickness + 2e-4)
    skinned = add_skin(scene)
    yield "tumour 1 mm deeper under the skin", replace_first(skinned, depth=scene.inclusion[0].depth + 1e-3)


def add_skin(scene: Scene, thickness: float = SKIN.thickness, modulus: float = SKIN.youngs_modulus) -> Scene:
    """Return the scene with a layer on top of its tissue."""
    skin = SKIN.model_copy(update={"thickness": thickness, "youngs_modulus": modulus})
    return scene.model_copy(update={"tissue": scene.tissue.model_copy(update={"layer": (skin,)})})


def replace_first(scene: Scene, **updates: float) -> Scene:
    first, *others = scene.inclusion
    return scene.model_copy(update={"inclusion": (first.model_copy(update=updates), *others)})


def processor() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


def answer_timed(level: SolidEvaluator, scene: Scene, accuracy: float, cache: Path | None) -> tuple[Result, float]:
    with use_limits(Limits(seconds=3600.0)), tempfile.TemporaryDirectory() as empty:
        if cache is None:
            os.environ[CACHE_VARIABLE] = empty
        start = processor()
        return level.evaluate(scene, accuracy), processor() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", type=Path, default=SCENE)
    parser.add_argument("--accuracy", type=float, default=0.01)
    parser.add_argument("--cache", type=Path)
    given = parser.parse_args()
    if given.cache is not None:
        os.environ[CACHE_VARIABLE] = str(given.cache)
    scene, name, console = read_scene(given.scene), given.scene.stem, Console(width=150)
    measure_changes(scene, changes(scene), given.accuracy, name, given.cache).print(console)
    if not scene.tissue.layer:
        measure_changes(add_skin(scene), iterate_skins(scene), given.accuracy, f"{name} with a skin", given.cache).print(console)


def measure_changes(
    scene: Scene, others: Iterable[tuple[str, Scene]], accuracy: float, name: str, cache: Path | None
) -> MeasuredTable:
    shared = SolidEvaluator(workspace=Workspace())
    table = MeasuredTable(f"{name} at accuracy {accuracy:g}", COLUMNS)
    first, seconds = answer_timed(shared, scene, accuracy, cache)
    table.add("the first scene", seconds, None, None, first.error_estimate, peak())
    for what, changed in others:
        print(f"{what} ...", file=sys.stderr, flush=True)
        warm_result, quick = answer_timed(shared, changed, accuracy, cache)
        alone, slow = answer_timed(SolidEvaluator(workspace=Workspace()), changed, accuracy, cache)
        difference = abs((warm_result.ratio or 0.0) / (alone.ratio or 1.0) - 1)
        print(what, slow, quick, difference, warm_result.error_estimate, peak(), file=sys.stderr, flush=True)
        table.add(what, slow, quick, difference, warm_result.error_estimate, peak())
    table.note("apart: of both ratios; peak: of this process so far")
    return table


def peak() -> int:
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


if __name__ == "__main__":
    main()
