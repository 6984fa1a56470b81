"""The closed form's stated errors: where their weights come from, and how they do on other scenes.

``python -m benchmarks.closed_form.error FILE`` audits: for the scenes of a file of ``scenes.py`` it prints quantiles
of the true errors of ln(ratio), of the logarithms of both totals and of the log-sensitivity, of the stated ones, and of true
over stated, which must stay below 1. With ``--fit`` it writes weights for eq. CF.19, and where they come from, to
``solver/closed_form/error_weights.json``; ``--seeds 1:1600 2:500`` says how many of the scenes each seed drew. No weight is below
``LOWEST``, the sum of the logarithms of all stated errors as small as linear programming makes it (each round weighs a scene by
what it was told before), so that no scene of the file or of tests/reference is told less than ``MARGIN`` times its error.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linprog

from benchmarks.closed_form.scenes import answered
from geometry import Scene, read_scene
from geometry.common.arrays import Floats
from solver.closed_form.designs import parameters
from solver.closed_form.error_bound import LEAST_SENSITIVITY, QUANTITIES, errors
from solver.closed_form.error_features import features
from solver.closed_form.level import LARGEST_ERROR, ClosedForm, variants

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "tests" / "reference"
WEIGHTS = ROOT / "solver" / "closed_form" / "error_weights.json"
FOLDERS = ("axisymmetric", "extra", "extreme", "extremes", "half-space", "off-axis", "solid", "layers")
MARGIN = 2.5
ROUNDS = 10
MOST = 20.0  # weight
LOWEST = {  # weights of what physics lets one expect even if no scene of the file asks for more
    "always": 0.01, "cancelled": 0.003, "inner": 0.02, "outer": 0.02, "inner small": 0.1, "inner soft": 0.05,
    "outer tall shell": 0.2, "outer soft shell": 0.1, "soft squared": 0.02, "hairline small": 0.1, "spheres near surface": 0.5,
    "spheres near floor": 0.1, "spheres near sides": 1.0, "spheres under rim": 0.02, "spheres several": 0.02, "side 2": 0.03,
    "side 4": 0.3, "side 8": 1.0, "side slender": 0.2, "cut 4": 0.05, "cut 8": 0.3, "cut slender": 0.03,
    "thin": 0.005, "very thin": 0.002,
}  # fmt: skip
SHARES = (0.1, 0.5, 0.9, 0.99, 1.0)
LEAST = {"ratio": 1e-3, "inner": 1e-3, "outer": 1e-3, "sensitivity": 1e-5}  # told errors below these are all as good


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--seeds", nargs="+", default=[], metavar="SEED:SCENES", help="what drew the scenes of a fit")
    options = parser.parse_args()
    scenes = list(answered(options.file))
    if options.fit:
        seeds = {seed: int(number) for seed, number in (drawn.split(":") for drawn in options.seeds)}
        if sum(seeds.values()) != len(scenes):
            parser.error(f"--seeds add up to {sum(seeds.values())} scenes, the file holds {len(scenes)}")
        found = {"origin": origin(seeds), "weights": fit(list(rows(scenes + list(references()))))}
        WEIGHTS.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    else:
        audit(list(rows(scenes)))


def origin(seeds: dict[str, int]) -> dict[str, Any]:
    """Where weights fitted now come from."""
    return {
        "script": "python -m benchmarks.closed_form.error FILE --fit",
        "date": date.today().isoformat(),
        "scenes": sum(seeds.values()),
        "seeds": seeds,
        "references": FOLDERS,
        "margin": MARGIN,
    }


def references() -> Iterator[tuple[Scene, dict[str, Any]]]:
    """Yield the plain scenes of tests/reference that the closed form takes, with their answers."""
    for folder in FOLDERS:
        for name, values in json.loads((REFERENCE / folder / "expected.json").read_text()).items():
            scene = read_scene(REFERENCE / folder / f"{name}.toml")
            if scene.probe.groove is None and ClosedForm().refusal(scene) is None:
                keys = {"stress_inner": "stress_inner_pa", "stress_outer": "stress_outer_pa", "stiffness": "stiffness_n_per_m"}
                found = {key: values[old] for key, old in keys.items()}
                yield scene, found | {"log_sensitivity": values.get("log_sensitivity")}


@dataclass(frozen=True)
class JudgedScene:
    """A scene's features, true and stated errors by the names of ``QUANTITIES``; no error of a sensitivity that is not known."""

    features: dict[str, dict[str, float]]
    true: dict[str, float]
    stated: dict[str, float]


def rows(scenes: list[tuple[Scene, dict[str, Any]]]) -> Iterator[JudgedScene]:
    """Yield those of the scenes for which the formulas give totals above zero."""
    for scene, answer in scenes:
        shape, values = parameters(scene)
        forces, slopes, _ = (part[0] for part in variants(shape, [values]))
        if not (np.all(np.isfinite(forces)) and np.all(forces.sum(axis=2) > 0)):
            continue
        sided = shape.side_nodes > 0
        told = errors(scene, forces, slopes, sided)
        stated = told.log_ratio, *told.log_totals, told.sensitivity
        true = _true(scene, answer, forces[0], slopes[0])
        yield JudgedScene(
            dict(zip(QUANTITIES, features(scene, forces, slopes, sided), strict=True)),
            {name: error for name, error in zip(QUANTITIES, true, strict=True) if error is not None},
            dict(zip(QUANTITIES, map(float, stated), strict=True)),
        )


def _true(scene: Scene, answer: dict[str, Any], forces: Floats, slope: Floats) -> tuple[float | None, ...]:
    """Errors of ln(ratio), of the logarithms of both totals and of the log-sensitivity."""
    totals = forces.sum(axis=1)
    felt = np.array([answer["stress_inner"], answer["stress_outer"]]) * [scene.probe.inner_area, scene.probe.outer_area]
    exact = felt * answer["stiffness"] / felt.sum()
    wrong = np.log(totals / np.where(exact > 0, exact, totals * np.exp(-LARGEST_ERROR)))  # another sign is to be refused
    share, known = slope.sum(axis=1) / totals, answer["log_sensitivity"]
    sensitivity = None if known is None or scene.target is None else abs(float(share[0] - share[1]) - known)
    return abs(float(wrong[0] - wrong[1])), *map(float, np.abs(wrong)), sensitivity


def fit(found: list[JudgedScene]) -> dict[str, dict[str, float]]:
    """Return the weights above zero by quantity and feature."""
    return {kind: _fitted(kind, [row for row in found if kind in row.true]) for kind in QUANTITIES}


def _fitted(kind: str, known: list[JudgedScene]) -> dict[str, float]:
    names = list(known[0].features[kind])
    table = np.array([[row.features[kind][name] for name in names] for row in known])
    least = np.minimum(MARGIN * np.array([row.true[kind] for row in known]), LARGEST_ERROR)
    if kind == "sensitivity":
        least = np.maximum(least - LEAST_SENSITIVITY, 0)
    weights = _envelope(table, least, np.array([LOWEST.get(name, 0.0) for name in names]), LEAST[kind])
    return {name: float(f"{weight:.3g}") for name, weight in zip(names, weights, strict=True) if weight > 0}


def _envelope(table: Floats, least: Floats, lowest: Floats, floor: float) -> Floats:
    """Return w >= lowest with table w >= least and the sum of ln(table w) small, three digits, rounded up."""
    w = np.ones(table.shape[1])
    for _ in range(ROUNDS):
        price = table.T @ (1 / (table @ w + floor))
        w = linprog(price, A_ub=-table, b_ub=-least, bounds=[(low, MOST) for low in lowest]).x
    digits = 10.0 ** (np.floor(np.log10(np.maximum(w, 1e-30))) - 2)
    return np.where(w > 1e-6, np.ceil(w / digits) * digits, 0.0)


def audit(found: list[JudgedScene]) -> None:
    """Print quantiles over those that are not refused."""
    found = [row for row in found if row.stated["ratio"] <= LARGEST_ERROR]
    for kind in QUANTITIES:
        known = [row for row in found if kind in row.true]
        true, stated = (np.array([getattr(row, name)[kind] for row in known]) for name in ("true", "stated"))
        for text, values in (("true error", true), ("stated error", stated), ("true / stated", true / stated)):
            many = ", ".join(f"{share:.0%} {value:.3g}" for share, value in zip(SHARES, np.quantile(values, SHARES), strict=True))
            print(f"{kind}, {len(known)} scenes, {text}: {many}")


if __name__ == "__main__":
    main()
