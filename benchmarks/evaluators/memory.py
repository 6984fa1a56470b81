"""Check that the memory of a process that evaluates many unlike scenes stops growing once the workspace is full.

    python -m benchmarks.evaluators.memory [--answers 300]

Random scenes are evaluated by each evaluator in turn, at three accuracies in turn;
after every fifty a line with the memory of the process, the most in between, the bytes that the workspace holds, and the
processor's seconds. Linux alone reports a process's memory so.

Duration: minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from itertools import cycle, islice
from pathlib import Path
from time import process_time
from typing import Any

from hypothesis import HealthCheck, Phase, given, settings
from rich.console import Console

from benchmarks.tables import MeasuredTable
from geometry import ProbeError, Scene
from solver import evaluate
from solver.linalg.workspace import get_workspace
from tests.support.random_scenes import scenes

EVALUATORS = ("published", "closed-form", "equivalent-inclusion", "axisymmetric")
ON_AXIS = ("published", "axisymmetric")
ACCURACIES = (0.05, 0.01, 0.003)
QUESTIONS_PER_ROW = 50
DRAWING = settings(
    database=None, derandomize=True, deadline=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck)
)
STATUS, RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def draw_scenes(count: int, **kind: Any) -> list[Scene]:
    """Return random scenes of ``tests.support.random_scenes``, the same every time."""
    kept: list[Scene] = []

    @settings(DRAWING, max_examples=count)
    @given(scene=scenes(**kind))
    def draw(scene: Scene) -> None:
        kept.append(scene)

    draw()
    return kept


def questions(count: int) -> Iterator[tuple[Scene, str, float]]:
    """Yield scenes with the evaluator and the accuracy of their evaluation; each evaluator sees every accuracy."""
    kinds = {True: draw_scenes(count), False: draw_scenes(count, farthest=1.0, tumours=2)}
    each = {on_axis: cycle(scenes) for on_axis, scenes in kinds.items()}
    for number, evaluator in enumerate(islice(cycle(EVALUATORS), count)):
        yield next(each[evaluator in ON_AXIS]), evaluator, ACCURACIES[number // len(EVALUATORS) % len(ACCURACIES)]


def memory(key: str) -> int:
    """Return bytes of this process: ``VmRSS`` now, ``VmHWM`` the most since ``reset``."""
    (line,) = (line for line in STATUS.read_text().splitlines() if line.startswith(f"{key}:"))
    return 1024 * int(line.split()[1])


def reset() -> None:
    """Begin to look for the most memory anew."""
    RESET.write_text("5")


def is_answered(scene: Scene, evaluator: str, accuracy: float) -> bool:
    """Whether the evaluator takes the scene."""
    try:
        evaluate(scene, evaluator, accuracy)
    except ProbeError:
        return False
    return True


def measure_memory(count: int, each: int = QUESTIONS_PER_ROW) -> MeasuredTable:
    """Ask, and write down what is held after ``each`` so many."""
    columns = "after, count", "refused, count", "memory, MB", "most since the last, MB", "workspace, MB", "processor, s"
    table = MeasuredTable("Memory of one process that answers unlike scenes", columns)
    refused, start = 0, process_time()
    reset()
    for number, question in enumerate(questions(count), 1):
        refused += not is_answered(*question)
        if number % each == 0 or number == count:
            held = (memory("VmRSS"), memory("VmHWM"), get_workspace().bytes_held)
            table.add(number, refused, *(round(size / 1e6) for size in held), process_time() - start)
            reset()
    return table


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--answers", type=int, default=300)
    options = parser.parse_args()
    measure_memory(options.answers).print(Console())


if __name__ == "__main__":
    main()
