"""Print how much longer each evaluator takes for a scene with films than for the same scene without, in processor time.

    python -m benchmarks.films.cost [--evaluator axisymmetric|equivalent-inclusion|closed-form|contact|solid] [--repeats N]
    python -m benchmarks.films.cost --random 50 [--seed 1]

The scene is ``examples/scene.toml`` with the stacks of ``benchmarks.films.bonds``. Every repeat evaluates it without films and
then with each stack. All are new probes, whose inner radii differ by 1e-6, so that no result of an earlier evaluation is used
again. Figures are medians of the repeats' quotients. "eq. (12)" has the two tapes, too, but takes the charge as d33 times the
force: the same scene without film charges. ``contact`` takes a third of the repeats, ``solid`` a tenth.

``--random N`` evaluates N random probes by ``axisymmetric`` instead, films with one of eight kinds of bond, and prints the median
and the largest quotient of each accuracy. A time is the shorter of two, after an evaluation that builds tables. N = 50
takes two minutes of processor.

Duration: ten minutes of processor.
"""

from __future__ import annotations

import argparse
import itertools
import math
import random
import statistics
from collections.abc import Iterator
from time import process_time

from benchmarks.films.bonds import EXAMPLE, FILM_THICKNESSES, STACKS, print_table, with_film
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
GOAL = 1.15  # quotient
BOND_RANGES = {  # by kind: thickness, m; Young's modulus, Pa; Poisson's ratio
    "glue": ((5e-6, 5e-5), (5e8, 5e9), (0.3, 0.45)),
    "tape": ((2e-5, 7.4e-5), (1e5, 3e6), (0.4, 0.49)),
    "stiff tape": ((2e-5, 7.4e-5), (3e6, 1e8), (0.4, 0.49)),
    "thick tape": ((7.5e-5, 2.5e-4), (1e5, 1e7), (0.4, 0.49)),
}
RANDOM_BONDS: tuple[dict[str, str], ...] = (
    {},
    {"bond_to_base": "glue", "bond_to_block": "glue"},
    {"bond_to_base": "tape"},
    {"bond_to_base": "stiff tape"},
    {"bond_to_base": "tape", "bond_to_block": "tape"},
    {"bond_to_base": "thick tape", "bond_to_block": "thick tape"},
    {"bond_to_base": "glue", "bond_to_block": "tape"},
    {"bond_to_base": "tape", "bond_to_block": "glue"},
)


def main() -> None:
    """Print a table with a row for each evaluator and accuracy."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--evaluator", choices=sorted({name for name, _ in SETTINGS}))
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--random", type=int, default=0, metavar="N", help="evaluate N random probes instead")
    parser.add_argument("--seed", type=int, default=1, help="of the random probes")
    options = parser.parse_args()
    if options.random:
        print_random(options.random, options.seed)
        return
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


def print_random(count: int, seed: int) -> None:
    """Print median and largest quotient over random probes for each accuracy of ``axisymmetric``, and how many reach the goal."""
    source = random.Random(seed)
    scenes = [draw_scene(source) for _ in range(count)]
    rows = []
    for name, accuracy in SETTINGS:
        if name == "axisymmetric":
            quotients = [time_random(scene, accuracy) for scene in scenes]
            good = sum(quotient <= GOAL for quotient in quotients)
            rows.append((f"{accuracy:g}", f"{statistics.median(quotients):.2f}", f"{max(quotients):.1f}", f"{good} of {count}"))
    print_table(("accuracy", "median", "largest", f"<= {GOAL}"), rows)


def time_random(scene: Scene, accuracy: float) -> float:
    """Return the quotient of a scene's time and that of the same scene without films."""
    tables = scene.model_dump(exclude_unset=True)
    del tables["probe"]["film"], tables["reading"]
    shortest = []
    for variant in (Scene.from_tables(tables), scene):
        seconds = []
        for repeat in range(3):
            varied = variant.replace({"probe.inner_radius": variant.probe.inner_radius * (1 + SMALL_CHANGE_RELATIVE * repeat)})
            start = process_time()
            evaluate(varied, evaluator="axisymmetric", accuracy=accuracy)
            seconds.append(process_time() - start)
        shortest.append(min(seconds[1:]))
    return shortest[1] / shortest[0]


def draw_scene(source: random.Random) -> Scene:
    """Return a random scene with films: blocks of 50 kPa to 2 MPa, films of 9 to 110 um, a quarter with a skin."""
    uniform = source.uniform

    def spread(low: float, high: float) -> float:
        return math.exp(uniform(math.log(low), math.log(high)))

    def bond(kind: str) -> dict[str, float]:
        thickness, modulus, ratio = BOND_RANGES[kind]
        return {"thickness": spread(*thickness), "youngs_modulus": spread(*modulus), "poisson_ratio": uniform(*ratio)}

    tables = read_scene(EXAMPLE).model_dump(exclude_unset=True)
    probe, tissue = tables["probe"], tables["tissue"]
    probe.pop("outer_radius", None)
    probe |= {"inner_radius": uniform(2.5e-3, 6e-3), "area_ratio": uniform(0.6, 2.4), "gap": spread(5e-5, 6e-4)}
    probe["height"] = uniform(1.5e-3, 6e-3)
    for block in ("inner", "outer"):
        probe[block] = {"youngs_modulus": spread(5e4, 2e6), "poisson_ratio": uniform(0.45, 0.49)}
    bonds = source.choice(RANDOM_BONDS)
    probe["film"] = {"thickness": source.choice(FILM_THICKNESSES)} | {side: bond(kind) for side, kind in bonds.items()}
    tissue["youngs_modulus"] = spread(3e3, 3e4)
    diameter, cover = uniform(4e-3, 14e-3), spread(5e-4, 1.5e-2)
    modulus = tissue["youngs_modulus"] * spread(2, 20)
    inclusion = {"diameter": diameter, "depth": cover + diameter / 2, "youngs_modulus": modulus, "poisson_ratio": 0.45}
    if source.random() < 0.25:
        tissue["layer"] = [{"thickness": spread(5e-4, 3e-3), "youngs_modulus": spread(2e4, 4e5), "poisson_ratio": 0.45}]
    tables["inclusion"] = [] if source.random() < 0.1 else [inclusion]
    tables["contact"] = {"interface": source.choice(["bonded", "frictionless"])}
    return Scene.from_tables(tables | {"reading": {"observable": "charge"}})


if __name__ == "__main__":
    main()
