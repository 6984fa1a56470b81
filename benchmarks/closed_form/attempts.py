"""Other ways to state the closed form's errors, beside eq. CF.19: what each would state, fitted to the same scenes.

``python -m benchmarks.closed_form.attempts FILE`` prints for each way the median stated over the median true error when fitted
without a margin to the scenes of a file of ``scenes.py`` and those of tests/reference, and, in brackets, times the margin that
all but one in a thousand of the scenes ask for when a quarter at a time is left out of the fit:

- the sum: eq. CF.19;
- without finer: the same on the other nine features. What more functions would change is not asked for;
- a product: of powers of 0.01 + feature / its largest, no power negative;
- ordinary scenes apart: a sum of its own for scenes without layers whose blocks are 4 to 400 times as stiff as the tissue, whose
  sides are 2.4 outer radii away or more and whose spheres are covered by a quarter of their diameter or more.

Duration: minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.optimize import linprog

from benchmarks.closed_form.envelope import compute_weights
from benchmarks.closed_form.error import references, rows
from benchmarks.closed_form.scenes import read_answers
from geometry import Scene
from geometry.common.arrays import Floats
from solver.closed_form.error_bound import BOUNDED_QUANTITIES, MIN_SENSITIVITY_ERROR
from solver.closed_form.error_features import FEATURE_NAMES

FEATURE_SLACK = 0.01  # beside features relative to their largest: powers of zero state nothing
MISSED_SHARE = 0.001  # of the scenes left out
Fit = Callable[[Floats, Floats], Callable[[Floats], Floats]]  # features and errors of scenes; what it states of features


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    scenes = list(read_answers(parser.parse_args().file)) + list(references())
    judged = [(scene, row) for scene, answer in scenes for row in rows([(scene, answer)])]
    usual = np.array([ordinary(scene) for scene, _ in judged])
    print(f"{len(judged)} scenes, {usual.sum()} ordinary")
    for place, kind in enumerate(BOUNDED_QUANTITIES):
        known = np.array([kind in row.true for _, row in judged])
        true = np.array([row.true[kind] for (_, row), is_known in zip(judged, known, strict=True) if is_known])
        table = np.array([row.features[:, place] for _, row in judged])[known]
        other = np.delete(table, FEATURE_NAMES.index("finer"), axis=1)
        alone = np.zeros(len(true), bool)
        spare = MIN_SENSITIVITY_ERROR if kind == "sensitivity" else 0.0
        ways = [("the sum", fit_sum, table, alone), ("without finer", fit_sum, other, alone)]
        ways += [("a product", fit_product, table, alone), ("ordinary scenes apart", fit_sum, table, usual[known])]
        print(
            f"{kind}: "
            + ", ".join(f"{name} {describe_fit(fit, values, groups, true, spare)}" for name, fit, values, groups in ways),
            flush=True,
        )


def ordinary(scene: Scene) -> bool:
    """Whether a scene is of those that are fitted apart."""
    probe, tissue = scene.probe, scene.tissue
    side = np.inf if tissue.shape == "half-space" else tissue.radius if tissue.shape == "cylinder" else tissue.breadth / 2
    times = [block.youngs_modulus / tissue.youngs_modulus for block in (probe.inner, probe.outer)]
    covers = [body.depth / (body.diameter or np.inf) - 0.5 for body in scene.inclusion]
    has_near_walls = side < 2.4 * probe.tube_radius or min(covers, default=1.0) < 0.25
    return not (has_near_walls or tissue.layer) and min(times) > 4 and max(times) < 400


def describe_fit(fit: Fit, table: Floats, groups: Floats, true: Floats, spare: float) -> str:
    """Fit all scenes, then without a quarter at a time; each of the ``groups`` is fitted alone; ``spare`` is stated anyway."""
    target = np.maximum(true - spare, 0.0)
    quarter = np.random.default_rng(5).integers(0, 4, len(true))
    whole, left_out = np.zeros(len(true)), np.zeros(len(true))
    for kind in np.unique(groups):
        group = groups == kind
        whole[group] = fit(table[group], target[group])(table[group]) + spare
        for part in range(4):
            seen, new = group & (quarter != part), group & (quarter == part)
            left_out[new] = fit(table[seen], target[seen])(table[new]) + spare
    times = float(np.median(whole) / np.median(true))
    margin = max(1.0, float(np.quantile(true / np.maximum(left_out, 1e-12), 1 - MISSED_SHARE)))
    return f"{times:.1f} ({times * margin:.1f})"


def fit_sum(table: Floats, true: Floats) -> Callable[[Floats], Floats]:
    """Eq. CF.19 without a margin."""
    weights = compute_weights(table, true, float(np.median(true)) / 10)
    return lambda features: features @ weights


def fit_product(table: Floats, true: Floats) -> Callable[[Floats], Floats]:
    """The product with the least mean of logarithms, by linear programming."""
    top = table.max(axis=0) + 1e-12

    def logarithms(features: Floats) -> Floats:
        return np.column_stack([np.ones(len(features)), np.log(FEATURE_SLACK + features / top)])

    rows_of = logarithms(table)
    log_target = np.log(np.maximum(true, np.median(true) / 30))
    bounds = [(None, None)] + [(0, None)] * table.shape[1]
    powers = linprog(rows_of.mean(axis=0), A_ub=-rows_of, b_ub=-log_target, bounds=bounds).x
    assert powers is not None
    return lambda features: np.exp(logarithms(features) @ powers)


if __name__ == "__main__":
    main()
