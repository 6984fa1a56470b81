"""Compare the stated errors of charges with results a hundred times more accurate, for films and bonds drawn at random.

    python -m benchmarks.films.extremes [--films 300] [--seed 1] [--rows FILE]

Films of 1 to 500 um, bonds of 1 kPa to 10 GPa and 1 to 300 um on both sides, insets, in the example scene at an accuracy of 0.01.
With ``--rows`` every film's figures are appended to a file of JSON lines, and a run that was cut off continues where it stopped.

Duration: minutes.
"""

from __future__ import annotations

import argparse
import functools
import math
import random
from pathlib import Path

from benchmarks.rows import Row, RowFile
from geometry.common.errors import ProbeError
from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene
from solver import evaluate
from solver.results.result import Result

EXAMPLE = Path(__file__).parents[2] / "examples" / "scene.toml"
ACCURACY, TRUE_ACCURACY = 0.01, 1e-4
RELATIVE_FIELDS = ("charge_ratio", "charge_per_force_inner", "charge_per_force_outer")


def draw_film(source: random.Random) -> JsonObject:
    """Return the table of a film with two bonds, SI."""

    def draw_between(low: float, high: float) -> float:
        return math.exp(source.uniform(math.log(low), math.log(high)))

    def draw_bond() -> JsonObject:
        sizes = {"thickness": draw_between(1e-6, 3e-4), "youngs_modulus": draw_between(1e3, 1e10)}
        return sizes | {"poisson_ratio": source.uniform(0.0, 0.499)}

    film: JsonObject = {"thickness": draw_between(1e-6, 5e-4), "youngs_modulus": draw_between(1e8, 1e10)}
    film |= {"poisson_ratio": source.uniform(0.0, 0.45), "bond_to_base": draw_bond(), "bond_to_block": draw_bond()}
    return film | ({"electrode_inset": draw_between(1e-5, 5e-4)} if source.random() < 0.5 else {})


def compute_shares(result: Result, true: Result) -> dict[str, float]:
    """Return the true over the stated error of each quantity of a result; the true result's own error is taken off the first."""
    shares = {}
    for name in RELATIVE_FIELDS:
        difference = abs(getattr(result, name) / getattr(true, name) - 1)
        shares[name] = max(0.0, difference - getattr(true, f"{name}_error")) / getattr(result, f"{name}_error")
    difference = abs((result.charge_log_sensitivity or 0.0) - (true.charge_log_sensitivity or 0.0))
    difference -= true.charge_log_sensitivity_error or 0.0
    return shares | {"charge_log_sensitivity": max(0.0, difference) / (result.charge_log_sensitivity_error or math.inf)}


def compute_row(film: JsonObject) -> Row:
    """Return the shares of a film's quantities, or the sentence of its refusal."""
    tables = read_scene(EXAMPLE).model_dump(exclude_unset=True)
    probe = tables["probe"] | {"film": film}
    scene = Scene.from_tables(tables | {"probe": probe, "reading": {"observable": "charge"}})
    try:
        result, true = (evaluate(scene, evaluator="axisymmetric", accuracy=a) for a in (ACCURACY, TRUE_ACCURACY))
    except ProbeError as refusal:
        return {"refused": str(refusal)}
    return compute_shares(result, true)


def main() -> None:
    """Print the largest true over stated error, and how many exceed it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--films", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rows", type=Path, help="file of rows, from which a run continues that was cut off")
    options = parser.parse_args()
    source, rows, worst, above, refused = random.Random(options.seed), RowFile(options.rows), 0.0, 0, 0
    for number in range(options.films):
        film = draw_film(source)
        shares = rows.get(f"seed {options.seed}, film {number}", functools.partial(compute_row, film))
        if "refused" in shares:
            refused += 1
            print(f"film {number}: refused: {shares['refused']}", flush=True)
            continue
        largest = max(shares, key=lambda name: shares[name])
        above += shares[largest] > 1
        if shares[largest] > worst:
            worst = shares[largest]
            print(f"film {number}: {largest} {worst:.2f} of its stated error; {film}", flush=True)
    print(f"{options.films} films, {refused} refused: largest true over stated error {worst:.2f}, above it: {above}")


if __name__ == "__main__":
    main()
