"""Draw random scenes, compute their converged results and keep both in a file for fits and audits of stated errors.

``python -m benchmarks.closed_form.scenes FILE --scenes N --seed K`` draws ``random_scenes``, has ``axisymmetric`` or, beside the
axis, ``equivalent-inclusion`` answer each, and appends scene and answer as a line of JSON. Started again it goes on; about one
scene a second.

Duration: about a second per scene.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.closed_form.random_scenes import draw
from geometry import InputError, Scene
from solver import evaluate
from solver.closed_form.evaluator import ClosedForm
from solver.linalg.memory import give_back

ACCURACY = 0.01
KEPT_KEYS = ("ratio", "stress_inner", "stress_outer", "stiffness", "log_sensitivity", "error_estimate")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--scenes", type=int, default=1500)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    known = len(list(read_answers(options.file))) if options.file.exists() else 0
    with options.file.open("a") as file:
        for number in range(known, options.scenes):
            scene, answer = _next(np.random.default_rng([options.seed, number]))
            line = {"scene": scene.model_dump(mode="json", exclude_unset=True), "answer": answer}
            file.write(json.dumps(line) + "\n")
            file.flush()
            give_back()


def read_answers(file: Path) -> Iterator[tuple[Scene, dict[str, float | None]]]:
    """Yield the scenes of a file with their answers: the keys ``KEPT_KEYS``, those that no warning tells to be unsure."""
    for line in file.read_text().splitlines():
        record = json.loads(line)
        yield Scene.model_validate(record["scene"]), record["answer"]


def _next(rng: np.random.Generator) -> tuple[Scene, dict[str, float | None]]:
    """Draw until a scene fits together, the closed form takes it, and an evaluator knows its ratio."""
    while True:
        try:
            scene = draw(rng)
            if ClosedForm().refusal(scene) is not None:
                continue
            off_axis = any(body.x != scene.placement.x for body in scene.inclusion)
            result = evaluate(scene, "equivalent-inclusion" if off_axis else "axisymmetric", ACCURACY)
        except (InputError, ValueError):
            continue
        if result.ratio is None or not (result.error_estimate or 1.0) <= 0.02:
            continue
        answer = {key: getattr(result, key) for key in KEPT_KEYS}
        if any(note.kind == "sensitivity" for note in result.warnings):
            answer["log_sensitivity"] = None
        return scene, answer


if __name__ == "__main__":
    main()
