"""Speed against accuracy on the reference scenes: ``python benchmarks/accuracy.py`` prints the README's table.

For every evaluator and accuracy asked for: the worst true error of the ratio over the eight
scenes of tests/reference/axisymmetric (converged results of an independent code), the worst
stated error, and the median and largest time of one evaluation, all in one process.
"""

from __future__ import annotations

import json
from pathlib import Path
from statistics import median

from geometry import Scene, read_scene
from solver import Result, evaluate

FOLDER = Path(__file__).parents[1] / "tests" / "reference" / "axisymmetric"
SETTINGS = (
    ("closed-form", 0.01),
    ("equivalent-inclusion", 0.01),
    ("equivalent-inclusion", 0.003),
    ("axisymmetric", 0.05),
    ("axisymmetric", 0.01),
    ("axisymmetric", 0.001),
    ("axisymmetric", 0.0001),
)


def main() -> None:
    expected = json.loads((FOLDER / "expected.json").read_text())
    scenes = [(read_scene(FOLDER / f"{name}.toml"), values["ratio"]) for name, values in expected.items()]
    for scene, _ in scenes:
        evaluate(scene, "closed-form")  # builds the functions, once
    print("| evaluator | accuracy asked | worst true error | worst stated error | median s | largest s |")
    print("|---|---|---|---|---|---|")
    for name, accuracy in SETTINGS:
        print(row(name, accuracy, scenes), flush=True)


def row(name: str, accuracy: float, scenes: list[tuple[Scene, float]]) -> str:
    """Return one line of the table."""
    results: list[tuple[Result, float]] = [(evaluate(scene, name, accuracy), ratio) for scene, ratio in scenes]
    true = max(abs((result.ratio or 0.0) / ratio - 1) for result, ratio in results)
    stated = max(result.error_estimate or 0.0 for result, _ in results)
    seconds = [result.seconds for result, _ in results]
    asked = "-" if name == "closed-form" else f"{accuracy:g}"
    return f"| {name} | {asked} | {true:.1e} | {stated:.1e} | {median(seconds):.2g} | {max(seconds):.2g} |"


if __name__ == "__main__":
    main()
