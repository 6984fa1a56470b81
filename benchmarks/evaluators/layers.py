"""Evaluate layered tissue by every evaluator: true and stated errors on NGSolve's scenes, and the cost of layers.

    python -m benchmarks.evaluators.layers [--part references|cost] [--evaluators closed-form axisymmetric ...] [--accuracy 0.01]

True errors are relative, of the ratio, and of the log-sensitivity where there is a target; one above its stated error is marked.
Costs are the processor's, medians of several in one process, against the same scene without its layers.

Duration: minutes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any

from geometry import ProbeError, Scene, read_scene
from solver import evaluate

REFERENCE = Path(__file__).parents[2] / "tests" / "reference"
FOLDERS = ("tissue-layers", "tissue-layers-off-axis")
LEVELS = ("closed-form", "equivalent-inclusion", "axisymmetric", "solid")
ACCURACY = {"solid": 0.05}
REPEATS = 7


def scenes() -> Iterator[tuple[str, Scene, dict[str, Any]]]:
    """Yield all scenes with their names and true values."""
    for folder in FOLDERS:
        for name, values in json.loads((REFERENCE / folder / "expected.json").read_text()).items():
            yield name, read_scene(REFERENCE / folder / f"{name}.toml"), values


def describe_errors(scene: Scene, values: dict[str, Any], level: str) -> str:
    """Describe true / stated error of the ratio and the true one of the log-sensitivity, or the reason for a refusal."""
    try:
        result = evaluate(scene, level, ACCURACY.get(level, 0.01))
    except ProbeError:
        return "refused"
    if result.ratio is None or result.error_estimate is None:
        return "null"
    error = abs(result.ratio / values["ratio"] - 1)
    wrong = " WRONG" if error > result.error_estimate + values["relative_uncertainty"] else ""
    text = f"{error:.1e} / {result.error_estimate:.1e}{wrong}"
    known = values.get("log_sensitivity")
    return text if known is None or result.log_sensitivity is None else f"{text}, {result.log_sensitivity / known - 1:+.1%}"


def references(levels: Sequence[str]) -> None:
    """Print a line a scene."""
    print(f"| scene | {' | '.join(levels)} |\n|{'---|' * (len(levels) + 1)}")
    for name, scene, values in scenes():
        print(f"| {name} | {' | '.join(describe_errors(scene, values, level) for level in levels)} |", flush=True)


def cost(levels: Sequence[str], accuracy: float) -> None:
    """Print how much longer a scene takes with its layers than without."""
    print(f"| scene | layers | {' | '.join(levels)} |\n|{'---|' * (len(levels) + 2)}")
    for name in ("skin-of-the-trial", "three-layers"):
        scene = read_scene(REFERENCE / FOLDERS[0] / f"{name}.toml")
        bare = scene.model_copy(update={"tissue": scene.tissue.model_copy(update={"layer": ()})})
        ratios = [_ratio(scene, bare, level, accuracy) for level in levels]
        print(f"| {name} | {len(scene.tissue.layer)} | {' | '.join(ratios)} |", flush=True)


def _ratio(scene: Scene, bare: Scene, level: str, accuracy: float) -> str:
    """Median of the ratio of two neighbours' times; each with a gap of its own, so that nothing is kept from before."""
    ratios = []
    for k in range(REPEATS):
        probe = scene.probe.model_copy(update={"gap": scene.probe.gap * (1 + 1e-3 * (k + 1))})
        times = []
        for case_scene in (scene, bare):
            start = process_time()
            try:
                evaluate(case_scene.model_copy(update={"probe": probe}), level, accuracy)
            except ProbeError:
                return "refused"
            times.append(process_time() - start)
        ratios.append(times[0] / times[1])
    return f"{median(ratios[1:]):.2f}"


def main() -> None:
    """Print one part or both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", choices=("references", "cost"))
    parser.add_argument("--evaluators", nargs="+", choices=LEVELS, default=LEVELS)
    parser.add_argument("--accuracy", type=float, default=0.01, help="of the costs")
    options = parser.parse_args()
    if options.part != "cost":
        references(options.evaluators)
    if options.part != "references":
        cost([level for level in options.evaluators if level != "solid"], options.accuracy)


if __name__ == "__main__":
    main()
