"""Print how much longer each evaluator takes for a scene with films than for the same scene without, in processor time.

    python -m benchmarks.films.cost [--evaluator axisymmetric|equivalent-inclusion|closed-form|contact|solid] [--repeats N]

The scene is ``examples/scene.toml`` with the stacks of ``benchmarks.films.bonds``. Every repeat evaluates it without films and
then with each stack. All are new probes, whose inner radii differ by 1e-6, so that no result of an earlier evaluation is used
again. Figures are medians of the repeats' quotients. "eq. (12)" has the two tapes, too, but takes the charge as d33 times the
force: the same scene without film charges. ``contact`` takes a third of the repeats, ``solid`` a tenth.

Duration: six minutes of processor.
"""

from __future__ import annotations

import argparse
import itertools
import statistics
from collections.abc import Iterator
from time import process_time

from benchmarks.films.bonds import EXAMPLE, STACKS, print_table, with_film
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene
from solver import evaluate

SETTINGS = (
    ("axisymmetric", 0.01),
    ("axisymmetric", 0.001),
    ("equivalent-inclusion", 0.01),
    ("closed-form", 0.01),
    ("contact", 0.01),
    ("solid", 0.02),
)
"""Evaluators and accuracies."""
SMALL_CHANGE_RELATIVE = 1e-6  # of the inner radius from one evaluation to the next: other numbers, the same mesh
COST_STACKS = {"eq. (12), two tapes": STACKS["tape on both sides, 0.4 MPa, 50 um"] | {"psi1": 0.0, "psi2": 0.0}} | STACKS
SLOW_SHARE = {"contact": 3, "solid": 10}  # by evaluator: of how many repeats one is made


def main() -> None:
    """Print a table with a row for each evaluator and accuracy."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--evaluator", choices=sorted({name for name, _ in SETTINGS}))
    parser.add_argument("--repeats", type=int, default=20)
    options = parser.parse_args()
    scene = read_scene(EXAMPLE)
    plain = scene.model_dump(exclude_unset=True)
    plain["probe"].pop("film", None)
    variants = {"without": Scene.from_tables(plain)} | {name: with_film(scene, dict(film)) for name, film in COST_STACKS.items()}
    radii = (scene.probe.inner_radius * (1 + SMALL_CHANGE_RELATIVE * k) for k in itertools.count())
    rows = []
    for name, accuracy in SETTINGS:
        if options.evaluator in (None, name):
            repeats = max(2, options.repeats // SLOW_SHARE.get(name, 1))
            rows.append((f"`{name}`", f"{accuracy:g}", *time_variants(variants, name, accuracy, radii, repeats)))
            print(*rows[-1], flush=True)
    print_table(("evaluator", "accuracy", "without, ms", *COST_STACKS), rows)


def time_variants(variants: dict[str, Scene], evaluator: str, accuracy: float, radii: Iterator[float], repeats: int) -> list[str]:
    """Return the median time of the first scene, ms, and the median quotients of the others' times over it, as texts."""
    seconds: dict[str, list[float]] = {name: [] for name in variants}
    for repeat in range(repeats + 1):
        for name, scene in variants.items():
            varied = scene.replace({"probe.inner_radius": next(radii)})
            start = process_time()
            evaluate(varied, evaluator=evaluator, accuracy=accuracy)
            if repeat:  # the first one imports, and builds tables and topologies
                seconds[name].append(process_time() - start)
    plain, *others = seconds.values()
    quotients = [statistics.median(a / b for a, b in zip(times, plain, strict=True)) for times in others]
    return [f"{1e3 * statistics.median(plain):.0f}", *(f"{quotient:.2f}" for quotient in quotients)]


if __name__ == "__main__":
    main()
