"""Compare true and stated errors of ``solid`` on drawn scenes that other evaluators solve exactly.

Usage: ``python -m benchmarks.solid.drawn [--scenes 30] [--seed 4] [--accuracy 0.02 --accuracy 0.01]``; ten seconds a scene and
accuracy. On the axis ``axisymmetric`` says what is true, with layers in every third scene; beside it, in every other third,
``equivalent-inclusion``. Scenes that these refuse, that are refused for their size, or whose probes and tumours nobody would
build are passed over. A share above 1 would be a bound below the truth.

Duration: ten seconds per scene.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.evaluators.inclusion_draws import DrawnScene, draw, draw_layered
from benchmarks.solid.changes import processor
from benchmarks.tables import MeasuredTable
from geometry import Refusal, Scene, SolveError
from geometry.common.resources import LimitReached, Limits, use_limits
from solver import evaluate
from solver.results.result import Result
from solver.solid.evaluator import SolidEvaluator

COLUMNS = ("scene", "accuracy", "true, error", "stated, error", "worst share", "log-sensitivity, share", "meshes", "processor, s")
QUANTITIES = "ratio", "stress_inner", "stress_outer", "stiffness"
TRUE_ACCURACIES = {"axisymmetric": 1e-3, "equivalent-inclusion": 3e-3}  # their accuracies
MIN_WALL_RELATIVE, MIN_HEIGHT_RELATIVE, MIN_LAYER_RELATIVE = (
    0.06,
    0.3,
    0.15,
)  # of the outer or the solid cylinder's radius: the least that is drawn
TUMOUR_DIAMETER_RANGE = 0.3, 2.5  # of the outer radius


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=30)
    parser.add_argument("--seed", type=int, default=4)
    parser.add_argument("--accuracy", action="append", type=float)
    given = parser.parse_args()
    table, count = MeasuredTable("drawn scenes", COLUMNS), 0
    for name, scene, evaluator_name in draws(given.seed):
        for cells in rows(scene, evaluator_name, given.accuracy or [0.02, 0.01]):
            print(name, *cells, file=sys.stderr, flush=True)
            table.add(name, *cells)
            count += 1
        if count >= given.scenes * len(given.accuracy or [0.02, 0.01]):
            break
    table.note("share: true error over stated, where the reference's own error is counted with the latter")
    table.print(Console(width=150))


def draws(seed: int) -> Iterator[tuple[str, Scene, str]]:
    """Yield scenes that fit, without end, and the evaluator that provides the true values."""
    number = -1
    while True:
        number, kind = number + 1, ("layers", "axis", "beside")[(number + 1) % 3]
        drawn = _usual((draw_layered if kind == "layers" else draw)(seed, number))
        outer = float(np.hypot(drawn.inner_radius + drawn.gap, drawn.area_ratio**0.5 * drawn.inner_radius))
        wall, size = (outer - drawn.inner_radius - drawn.gap) / outer, drawn.diameter / outer
        thin = any(height < MIN_LAYER_RELATIVE * drawn.inner_radius for height, _, _ in drawn.layers)
        if wall < MIN_WALL_RELATIVE or thin or not TUMOUR_DIAMETER_RANGE[0] < size < TUMOUR_DIAMETER_RANGE[1]:
            continue
        try:
            scene = drawn.scene()
            if kind == "beside":
                x = 1e-3 * outer * float(np.random.default_rng([seed, number, 7]).uniform(0.2, 1.5))
                body = scene.inclusion[0].model_copy(update={"x": x})
                scene = Scene.model_validate(scene.model_copy(update={"inclusion": (body,)}).model_dump())
        except ValueError:  # what is drawn does not fit
            continue
        yield f"{kind} {number}", scene, "equivalent-inclusion" if kind == "beside" else "axisymmetric"


def _usual(drawn: DrawnScene) -> DrawnScene:
    """Return the drawn scene within the range of probes that are built."""
    min_height = MIN_HEIGHT_RELATIVE * drawn.inner_radius
    return replace(
        drawn,
        cover=max(drawn.cover, 0.08),
        gap=max(drawn.gap, 0.02 * drawn.inner_radius),
        area_ratio=float(np.clip(drawn.area_ratio, 0.3, 4.0)),
        inner_height=max(drawn.inner_height, min_height),
        outer_height=max(drawn.outer_height, min_height),
    )


def rows(scene: Scene, evaluator_name: str, accuracies: list[float]) -> Iterator[tuple[Any, ...]]:
    try:
        with use_limits(Limits(seconds=60.0)):
            true = evaluate(scene, evaluator_name, TRUE_ACCURACIES[evaluator_name])
        if true.error_estimate is None or true.error_estimate > 2 * TRUE_ACCURACIES[evaluator_name]:
            return
        for accuracy in accuracies:
            meshes, start = list[str](), processor()
            with use_limits(Limits(seconds=90.0)):
                evaluator = SolidEvaluator(progress=meshes.append)
                forces = evaluator.solve_forces(scene, accuracy)
                result = evaluator.build_solution(scene, forces, accuracy).build_result(evaluator.name, scene, 0.0)
            seconds = processor() - start
            quotients = compute_quotients(result, true, forces.films[0].sensitivity_error)
            yield (accuracy, *quotients, sum(text.startswith("solving") for text in meshes), seconds)
    except (Refusal, SolveError, LimitReached) as fault:
        print(f"passed over: {fault}", file=sys.stderr)


def compute_quotients(result: Result, true: Result, bound: float) -> tuple[float, float, float, float | None]:
    """Return the largest true error of all quantities, the stated error, their quotient, and the same of log_sensitivity."""
    errors = [abs(getattr(result, name) / getattr(true, name) - 1) for name in QUANTITIES]
    stated, true_error = result.error_estimate or 0.0, true.error_estimate or 0.0
    sensitivity, true_sensitivity = result.log_sensitivity, true.log_sensitivity
    quotient = (
        None
        if sensitivity is None or true_sensitivity is None
        else abs(sensitivity - true_sensitivity) / (bound + true_error * abs(true_sensitivity))
    )
    return max(errors), stated, round(max(errors) / (stated + true_error), 2), None if quotient is None else round(quotient, 2)


if __name__ == "__main__":
    main()
