"""Compare results per second of a loop and of ``evaluate_many``, in one run.

    python -m benchmarks.peers.many [--count 50]

For each evaluator and set of designs: results per processor second by ``evaluate`` one by one and by ``evaluate_many``, each
from a workspace that knows the topology and nothing of the designs, in turn ``--repeats`` times, medians; their ratio; and the
largest difference of a ratio, in shares of the two ``error_estimate`` together.

moduli: of one design, over four decades; loads: of one design; gap: 50 gaps; gap x modulus: a factorial sweep of 5 gaps and 10
moduli; random: probe, depth, diameter and all moduli drawn within a quarter, one topology.

Duration: minutes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from statistics import median
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.peers.measured import KnownScene, cases
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load
from solver import Result, Workspace, evaluate, evaluate_many
from solver.linalg.threads import limit_to_one_thread
from solver.linalg.workspace import use_workspace

ACCURACIES = {"closed-form": 0.01, "axisymmetric": 0.005, "auto": 0.01}
DRAW_FACTOR = 1.25  # factor within which designs are drawn
GAP_COUNT = 5  # of the factorial sweep


def replace_modulus(scene: Scene, modulus: float, **other: float) -> Scene:
    """Return the scene with another tumour."""
    body = scene.inclusion[0].model_copy(update={"youngs_modulus": modulus, **other})
    return scene.model_copy(update={"inclusion": (body,)})


def replace_probe(scene: Scene, **lengths: Any) -> Scene:
    """Return the scene with another probe."""
    return scene.model_copy(update={"probe": scene.probe.model_copy(update=lengths)})


def sets(case: KnownScene, count: int) -> Iterator[tuple[str, list[Scene]]]:
    """Yield what is evaluated."""
    scene, gaps = case.scene, case.scene.probe.gap * np.linspace(1 / DRAW_FACTOR, DRAW_FACTOR, count)
    moduli, few_moduli = case.moduli(count).tolist(), case.moduli(count // GAP_COUNT).tolist()
    yield "moduli", [replace_modulus(scene, modulus) for modulus in moduli]
    pressed = [Load(indentation=float(deep)) for deep in np.linspace(1e-6, 1e-4, count)]
    yield "loads", [scene.model_copy(update={"load": load}) for load in pressed]
    yield "gap", [replace_probe(scene, gap=gap) for gap in gaps.tolist()]
    chosen = gaps[:: count // GAP_COUNT].tolist()
    yield "gap x modulus", [replace_modulus(replace_probe(scene, gap=gap), modulus) for gap in chosen for modulus in few_moduli]
    yield "random", [draw_design(scene, np.random.default_rng(k)) for k in range(count)]


def draw_design(scene: Scene, rng: np.random.Generator) -> Scene:
    """Return a design near that of a scene."""

    def draw_near(value: float) -> float:
        return float(value * DRAW_FACTOR ** rng.uniform(-1, 1))

    probe, body = scene.probe, scene.inclusion[0]
    blocks = {name: getattr(probe, name).model_copy(update={"youngs_modulus": draw_near(getattr(probe, name).youngs_modulus)})
              for name in ("inner", "outer")}  # fmt: skip
    made = replace_probe(scene, gap=draw_near(probe.gap), **blocks)
    return replace_modulus(made, draw_near(body.youngs_modulus), diameter=(body.diameter or 0.0) * rng.uniform(0.9, 1.0))


def seconds(run: Callable[[], list[Any]], scenes: list[Scene], name: str) -> tuple[float, list[Any]]:
    """Processor time of a run in a workspace that has evaluated one design of the topology, and its results."""
    with use_workspace(Workspace()):
        for gap in (0.99, 0.995):  # twice: the second keeps its factorisations' analyses
            evaluate(replace_probe(scenes[0], gap=gap * scenes[0].probe.gap), name, ACCURACIES[name], linear=True)
        begin = time.process_time()
        answers = run()
        return time.process_time() - begin, answers


def compute_largest_difference(value: Any, other_value: Any) -> float:
    """Difference of two results in shares of their errors; nothing where one has no ratio."""
    if not (isinstance(value, Result) and isinstance(other_value, Result)) or value.ratio is None or other_value.ratio is None:
        return 0.0
    return abs(value.ratio / other_value.ratio - 1) / (
        (value.error_estimate or 0.0) + (other_value.error_estimate or 0.0) or np.inf
    )


def row(name: str, what: str, scenes: list[Scene], repeats: int) -> tuple[str, ...]:
    """One line of the table."""
    options: dict[str, Any] = {"evaluator": name, "accuracy": ACCURACIES[name], "linear": True}
    times: list[tuple[float, float]] = []
    differ = 0.0
    for _ in range(repeats):
        alone, ones = seconds(lambda: [evaluate(scene, **options) for scene in scenes], scenes, name)
        together, batch_answers = seconds(lambda: [*evaluate_many(scenes, **options)], scenes, name)
        times.append((alone, together))
        differ = max([differ, *(compute_largest_difference(*pair) for pair in zip(ones, batch_answers, strict=True))])
    alone, together = (median(timing) for timing in zip(*times, strict=True))
    ratio = median(timing / other for timing, other in times)
    return name, what, f"{len(scenes) / alone:.3g}", f"{len(scenes) / together:.3g}", f"{ratio:.1f}", f"{differ:.1g}"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--scene", default="shallow", help="one of benchmarks.peers.measured.NAMES")
    parser.add_argument("--evaluator", action="append", choices=ACCURACIES)
    options = parser.parse_args()
    (case,) = cases([options.scene])
    table = Table(title=f"{case.name}, results per second of processor time, one thread")
    for heading in ("evaluator", "designs", "loop", "evaluate_many", "ratio", "apart, in errors"):
        table.add_column(heading, justify="left" if heading in ("evaluator", "designs") else "right")
    with limit_to_one_thread():
        for name in options.evaluator or ACCURACIES:
            for what, scenes in sets(case, options.count):
                table.add_row(*row(name, what, scenes, options.repeats))
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
