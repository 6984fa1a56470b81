"""Print the plan of every reference scene as the table of docs/explanation/plan.md, and the cost of a plan beside an evaluation.

Usage: ``python -m benchmarks.evaluators.plans [--accuracy 0.01] [--folder axisymmetric --folder solid ...]``; seconds.

Duration: minutes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from time import process_time
from timeit import repeat

from geometry import Scene, read_scene
from solver import Decision, evaluate, plan
from solver.planning.plan import Plan
from solver.planning.plan import build_plan as estimate

REFERENCE = Path(__file__).parents[2] / "tests" / "reference"
FOLDERS = ("axisymmetric", "solid", "layers")
COLUMNS = {
    "groove": "groove",
    "sides that are not round": "sides",
    "far edges": "far edges",
    "the tissue beyond": "far end",
    "film compliance": "films",
    "elastic base": "base",
    "gap contact": "gap",
    "lift-off": "lift-off",
    "finite strain": "strain",
}
REPEATS = 7


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--accuracy", type=float, default=0.01)
    parser.add_argument("--folder", action="append", help=f"of tests/reference ({', '.join(FOLDERS)})")
    given = parser.parse_args()
    headings = ("scene", "evaluator", "target", "other inclusions", *COLUMNS.values())
    print("| " + " | ".join(headings) + " |")
    print("|" + "---|" * len(headings))
    times = []
    for name, scene in scenes(given.folder or FOLDERS):
        chosen_plan = plan(scene, given.accuracy)
        print("| " + " | ".join((name, str(chosen_plan.evaluator), *cells(chosen_plan, scene))) + " |")
        if chosen_plan.evaluator == "axisymmetric" and len(scene.inclusion) < 2:
            times.append(cost(scene, given.accuracy))
    if times:
        planning, evaluating = (1e3 * median(each) for each in zip(*times, strict=True))
        print(f"\na plan's estimates {planning:.0f} ms, axisymmetric after them {evaluating:.0f} ms of the processor")


def scenes(folders: list[str] | tuple[str, ...]) -> Iterator[tuple[str, Scene]]:
    for folder in folders:
        for name in json.loads((REFERENCE / folder / "expected.json").read_text()):
            yield name, read_scene(REFERENCE / folder / f"{name}.toml")


def cells(chosen_plan: Plan, scene: Scene) -> Iterator[str]:
    """Effects on the ratio: in brackets what is left out, after a dash what no evaluator knows."""
    bodies = [decision for decision in chosen_plan.decisions if decision.feature.startswith("inclusion")]
    target = scene.target
    yield "" if target is None else cell(bodies[target])
    yield ", ".join(cell(decision) for k, decision in enumerate(bodies) if k != target)
    for feature in COLUMNS:
        yield ", ".join(cell(decision) for decision in chosen_plan.decisions if decision.feature.startswith(feature))


def cell(decision: Decision) -> str:
    if decision.reason.startswith("no evaluator"):
        return f"- {decision.effect:.1g}"
    return f"{decision.effect:.2g}" if decision.modelled else f"({decision.effect:.1g})"


def cost(scene: Scene, accuracy: float) -> tuple[float, float]:
    """Seconds of the processor: of a plan's estimates, and of the evaluation that it asks for."""
    return seconds(lambda: estimate(scene, accuracy)), seconds(lambda: evaluate(scene, "axisymmetric", accuracy))


def seconds(run: Callable[[], object]) -> float:
    """Return the median time of several runs."""
    return median(repeat(run, timer=process_time, number=1, repeat=REPEATS))


if __name__ == "__main__":
    main()
