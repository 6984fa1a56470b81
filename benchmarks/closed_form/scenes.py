"""Draw random scenes of each class, compute their converged results and keep both in a file for the closed form's stated errors.

``python -m benchmarks.closed_form.scenes FILE CLASS --scenes N --seed K`` draws N scenes of a class, has ``axisymmetric`` or, off
the axis, ``equivalent-inclusion`` compute each, and appends scene and result as a line of JSON. Started again it continues.
Scenes whose result is not known to 0.15 %, off the axis 0.5 %, are drawn anew. With ``--searched`` each scene is the one of
the largest log-sensitivity, by the closed form, among 100 probes about a drawn one: what a search would pick. CLASS may be
"soft skin", too: layered scenes of ordinary probes on a layer softer than the tissue below.

Duration: 0.1 to 0.3 s per scene, 1.5 s off the axis.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.closed_form.random_scenes import DRAWN_KINDS, SOFT_SKIN, draw
from geometry import InputError, Scene
from solver import evaluate
from solver.closed_form.designs import build_parameters
from solver.closed_form.error_quantile import classify
from solver.closed_form.evaluator import ClosedForm
from solver.linalg.memory import give_back

ACCURACY, MAX_ERROR = 1e-3, 1.5e-3  # of axisymmetric
OFF_AXIS_ACCURACY, MAX_OFF_AXIS_ERROR = 0.008, 0.005  # of equivalent-inclusion, whose bounds are far above its errors
KEPT_KEYS = ("ratio", "stress_inner", "stress_outer", "stiffness", "log_sensitivity", "error_estimate")
SEARCHED_PROBES = 100


@dataclass(frozen=True)
class SolvedScene:
    """A drawn scene with its converged result: the keys ``KEPT_KEYS``; the log-sensitivity is None where it is not sure."""

    kind: str
    scene: Scene
    result: dict[str, float | None]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("kind", choices=DRAWN_KINDS, metavar="class")
    parser.add_argument("--scenes", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--searched", action="store_true")
    options = parser.parse_args()
    known = len(options.file.read_text().splitlines()) if options.file.exists() else 0
    with options.file.open("a") as file:
        for number in range(known, options.scenes):
            rng = np.random.default_rng([options.seed, DRAWN_KINDS.index(options.kind), number])
            solved = draw_solved(rng, options.kind, options.searched)
            scene = solved.scene.model_dump(mode="json", exclude_unset=True)
            file.write(json.dumps({"kind": solved.kind, "scene": scene, "answer": solved.result}) + "\n")
            file.flush()
            give_back()


def read_solved(file: Path) -> list[SolvedScene]:
    """Read the scenes of a file with their results."""
    records = [json.loads(line) for line in file.read_text().splitlines()]
    return [SolvedScene(record["kind"], Scene.model_validate(record["scene"]), record["answer"]) for record in records]


def draw_solved(rng: np.random.Generator, kind: str, searched: bool = False) -> SolvedScene:
    """Draw until a scene is of the class, the closed form takes it, and an evaluator knows its result."""
    scene_class = "layered" if kind == SOFT_SKIN else kind
    while True:
        try:
            scene = draw(rng, kind)
            scene = _search(rng, scene) if searched else scene
            if ClosedForm().refusal(scene) is not None or classify(build_parameters(scene)[0]) != scene_class:
                continue
            solved = solve(scene, kind)
        except (InputError, ValueError):
            continue
        if solved is not None:
            return solved


def solve(scene: Scene, kind: str) -> SolvedScene | None:
    """Return a scene with its converged result; None where that is not sure enough.

    Raises
    ------
    InputError
        The evaluator refuses the scene.
    """
    off_axis = kind == "off axis"
    name, accuracy = ("equivalent-inclusion", OFF_AXIS_ACCURACY) if off_axis else ("axisymmetric", ACCURACY)
    result = evaluate(scene, name, accuracy)
    if result.ratio is None or not (result.error_estimate or 1.0) <= (MAX_OFF_AXIS_ERROR if off_axis else MAX_ERROR):
        return None
    values = {key: getattr(result, key) for key in KEPT_KEYS}
    if any(note.kind == "sensitivity" for note in result.warnings):
        values["log_sensitivity"] = None
    return SolvedScene(kind, scene, values)


def _search(rng: np.random.Generator, scene: Scene) -> Scene:
    """Return the scene with that of many probes about its own whose log-sensitivity is largest by the closed form."""
    scenes = list(_vary_probe(rng, scene))
    solutions = ClosedForm().compute_films(scenes)
    sizes = [0.0 if isinstance(item, InputError) else abs(item.films.log_sensitivity or 0.0) for item in solutions]
    return scenes[int(np.argmax(sizes))]


def _vary_probe(rng: np.random.Generator, scene: Scene) -> Iterator[Scene]:
    """Yield scenes whose probes have lengths and moduli of up to 2.7 times, or of a 2.7th, of the scene's."""
    probe, blocks = scene.probe, {"inner": scene.probe.inner, "outer": scene.probe.outer}
    for radius, gap, wall, inner_height, outer_height, *factors in np.exp(rng.uniform(-1, 1, (SEARCHED_PROBES, 7))).tolist():
        hole = probe.inner_radius * radius + probe.gap * gap
        varied = {
            "inner_radius": probe.inner_radius * radius,
            "gap": probe.gap * gap,
            "outer_radius": hole + (probe.tube_radius - probe.hole_radius) * wall,
            "inner_height": probe.core_height * inner_height,
            "outer_height": probe.tube_height * outer_height,
        }
        for factor, (name, block) in zip(factors, blocks.items(), strict=True):
            varied[name] = {"youngs_modulus": factor * block.youngs_modulus, "poisson_ratio": block.poisson_ratio}
        try:
            yield Scene.model_validate(scene.model_dump(exclude_unset=True) | {"probe": varied})
        except ValueError:
            continue


if __name__ == "__main__":
    main()
