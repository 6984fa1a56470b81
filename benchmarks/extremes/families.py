"""Check the errors of interpolated results: drawn sweeps of one number, by ``evaluate_many`` and one by one.

A sweep takes a drawn scene (``inclusion_draws``, every third with layers of tissue), one of its lengths, moduli or Poisson's
ratios, a width from 2 % to two decades and 12 to 40 values, even or at random. Of every interpolated member the ratio, both film
forces and the log-sensitivity are compared with the single answer's, in shares of both bounds together, and the rule for loads;
of a few with an answer at a twentieth of the accuracy. One line for each that is above 1, then a table.

    python -m benchmarks.extremes.families --sweeps 200 --seed 1

Duration: half an hour.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rich.console import Console
from threadpoolctl import threadpool_limits

from benchmarks.evaluators.inclusion_draws import draw, draw_layered
from benchmarks.tables import MeasuredTable
from geometry import InputError, Scene
from geometry.common.errors import ProbeError
from solver.axisymmetric.evaluator import Axisymmetric
from solver.batch import find_smooth_kinds
from solver.families import EXCLUDED_NUMBERS, find_families, iterate_leaves
from solver.interpolation import interpolate_family
from solver.linalg.workspace import get_workspace
from solver.planning.load_limits import build_load_rule
from solver.planning.loads import LoadRule
from solver.results.evaluator import FilmSolution
from solver.results.film_forces import FilmForces

ACCURACIES = (0.02, 0.005, 0.001)
WIDTHS, COUNTS = (1.02, 100.0), (12, 40)
BODIES = ("probe", "tissue", "inclusion")  # whose numbers are swept
TRUTH_ACCURACY_FACTOR, TRUE_OF = 20.0, 3  # times the accuracy, and of how many members
SENSITIVITY_ACCURACY = 1e-5  # absolute, that a log-sensitivity is promised to
RULE_TOLERANCE_RELATIVE = (
    0.002  # relative, that rules for loads may differ by: a twentieth of it tells nothing of what is allowed
)
QUANTITIES = ("ratio", "inner", "outer", "log-sensitivity")


@dataclass(frozen=True)
class DrawnSweep:
    """Scenes that differ in one number, with what it is called."""

    name: str
    scenes: list[Scene]
    accuracy: float


@dataclass
class ComparedAnswers:
    """Shares of interpolated members, by what they are shares of: largest of each of ``QUANTITIES``, with how many members."""

    alone: list[Sequence[float]] = field(default_factory=list)
    finer: list[Sequence[float]] = field(default_factory=list)
    rules: list[float] = field(default_factory=list)


def sweep(seed: int, number: int) -> DrawnSweep | None:
    """Return a sweep, the same for the same seed and number; None where its scene's parts do not fit."""
    rng = np.random.default_rng([seed, number, 5])
    try:
        base = (draw_layered if number % 3 == 2 else draw)(seed, number).scene()
    except (InputError, ValueError):
        return None
    numbers = {
        path: value for path, value in iterate_leaves(base.model_dump()) if path[0] in BODIES and path not in EXCLUDED_NUMBERS
    }
    paths = sorted((path for path, value in numbers.items() if isinstance(value, float) and value > 0), key=str)
    path = paths[int(rng.integers(len(paths)))]
    width, count = np.exp(rng.uniform(*np.log(WIDTHS))), int(rng.integers(*COUNTS, endpoint=True))
    low = numbers[path] * width ** -rng.uniform()
    shares = np.linspace(0.0, 1.0, count) if rng.random() < 0.5 else rng.random(count)
    values = low * width**shares if rng.random() < 0.7 else low * (1 + (width - 1) * shares)
    made = (vary_number(base, path, value) for value in values.tolist())
    name = f"seed {seed}, number {number}, {'.'.join(map(str, path))} x {width:.3g}"
    return DrawnSweep(name, [member for member in made if member is not None], float(rng.choice(ACCURACIES)))


def vary_number(scene: Scene, path: tuple[Any, ...], value: float) -> Scene | None:
    """Return the scene with another number; None where that is not allowed."""
    if path[-1] == "poisson_ratio" and value >= 0.5:
        return None
    changed = replace_number(scene, path, value)
    try:
        return Scene(**{name: getattr(changed, name) for name in Scene.model_fields})
    except (InputError, ValueError):
        return None


def replace_number(part: Any, path: tuple[Any, ...], value: float) -> Any:
    """Return a model or a tuple of them with one number replaced."""
    if not path:
        return value
    first, *tail = path
    if isinstance(part, tuple):
        return (*part[:first], replace_number(part[first], tuple(tail), value), *part[first + 1 :])
    return part.model_copy(update={first: replace_number(getattr(part, first), tuple(tail), value)})


def shares(first: FilmForces, second: FilmForces) -> tuple[float, ...]:
    """Return differences of ``QUANTITIES`` over both bounds together."""
    bounds = first.bound + second.bound
    difference = np.abs(first.totals - second.totals) / np.maximum(bounds.totals, 1e-300)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.abs(np.log(np.abs(first.totals / second.totals)) @ [1.0, -1.0]) / bounds.log_ratio
    slopes = abs((first.log_sensitivity or 0.0) - (second.log_sensitivity or 0.0))
    sensitivity = slopes / max(first.sensitivity_error + second.sensitivity_error, SENSITIVITY_ACCURACY)
    return float(np.nan_to_num(ratios)), *map(float, difference), float(sensitivity)


def compare(drawn_sweep: DrawnSweep, compared: ComparedAnswers) -> None:
    """Compare a sweep's interpolated members, and say which are off."""
    get_workspace().begin()
    level, solved = Axisymmetric(), []
    for family in find_families(drawn_sweep.scenes, find_smooth_kinds):
        family_scenes = [drawn_sweep.scenes[place] for place in family.places]
        pairs = interpolate_family(family, family_scenes, level, drawn_sweep.accuracy)
        solved += [(scene, pair) for scene, pair in zip(family_scenes, pairs, strict=True) if pair is not None]
    remaining = []
    for scene, (answer, rule) in solved:
        (alone,) = level.solve_many([scene], [drawn_sweep.accuracy])
        if not isinstance(alone, FilmSolution) or (alone.notes, alone.plan) != (answer.notes, answer.plan):
            print(f"{drawn_sweep.name}: alone it is {alone}", flush=True)
        elif not np.array_equal(alone.films[0].forces, answer.films[0].forces):
            remaining.append((scene, answer.films[0]))
            compared.alone.append(shares(answer.films[0], alone.films[0]))
            tell(drawn_sweep, "alone", compared.alone[-1])
            if rule is not None:
                compared.rules.append(compare_rules(scene, rule))
                tell(drawn_sweep, "rule", [compared.rules[-1] / RULE_TOLERANCE_RELATIVE])
    chosen = np.random.default_rng(len(remaining)).permutation(len(remaining))[:TRUE_OF]
    for scene, film in (remaining[k] for k in chosen):
        (true,) = level.solve_many([scene], [drawn_sweep.accuracy / TRUTH_ACCURACY_FACTOR])
        if isinstance(true, FilmSolution):
            compared.finer.append(shares(film, true.films[0]))
            tell(drawn_sweep, "finer", compared.finer[-1])


def compare_rules(scene: Scene, rule: LoadRule) -> float:
    """Relative difference of a rule's largest load and stiffness from those of the scene's own."""
    scene_rule = build_load_rule(scene)
    return float(
        max(
            abs(rule.stiffness / scene_rule.stiffness - 1),
            abs(rule.strain / scene_rule.strain - 1),
            abs(rule.closure / scene_rule.closure - 1),
        )
    )


def tell(drawn_sweep: DrawnSweep, against: str, values: Sequence[float]) -> None:
    """Print a line where a share is above 1."""
    if max(values) > 1:
        print(
            f"{drawn_sweep.name}, accuracy {drawn_sweep.accuracy}: {against}, {', '.join(f'{value:.2g}' for value in values)}",
            flush=True,
        )


def main() -> None:
    """Draw, answer twice, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sweeps", type=int, default=200, help="drawn sweeps of each seed (200)")
    parser.add_argument("--first", type=int, default=0, help="number of the first (0)")
    parser.add_argument("--seed", type=int, action="append", help="of drawn sweeps (1)")
    options, compared, used, drawn, members = parser.parse_args(), ComparedAnswers(), 0, 0, 0
    numbers = range(options.first, options.first + options.sweeps)
    with threadpool_limits(1), Console(stderr=True).status("families") as status:
        for drawn_sweep in (sweep(seed, k) for seed in options.seed or [1] for k in numbers):
            if drawn_sweep is None:
                continue
            status.update(drawn_sweep.name)
            alone_count = len(compared.alone)
            try:
                compare(drawn_sweep, compared)
            except ProbeError as fault:
                print(f"{drawn_sweep.name}: {fault}")
            drawn, used, members = drawn + 1, used + (len(compared.alone) > alone_count), members + len(drawn_sweep.scenes)
    print(f"{drawn} sweeps of {members} scenes, {used} of them with {len(compared.alone)} interpolated members")
    table = MeasuredTable(
        "difference over both bounds, largest", ("against", "members", *(f"{name}, times" for name in QUANTITIES))
    )
    for name, rows in (("single answers", compared.alone), ("a twentieth of the accuracy", compared.finer)):
        if rows:
            table.add(name, str(len(rows)), *map(float, np.max(rows, axis=0)))
    table.note(f"rules for loads apart: {max(compared.rules, default=0.0):.1e}")
    table.print(Console(width=120))


if __name__ == "__main__":
    main()
