"""Fit the closed form's stated errors, 95 % quantiles by class of scene, and measure how many true errors they cover.

``python -m benchmarks.closed_form.error FILE... --fit --seeds K... --searched FILE...`` fits eq. CF.19 to scenes of files of
``scenes.py``, drawn with these seeds, and writes the tables of their classes in ``solver/closed_form``. The weights come from
quantile regression of the logarithms of the errors, all classes of a table together, scenes that a search picked among them. The
constants are calibrated class by class on the scenes as drawn: a tenth of them at a time is stated by weights fitted to the
others, and the constant is such that 95 % of all are covered (cross-conformal prediction).

Without ``--fit`` it prints for the scenes of the files, drawn with another seed, by class and quantity: how many true errors the
stated ones cover, with the coverage's 95 % interval (binomial, by Clopper and Pearson), the median stated over the median true
error, and the largest true over stated error; then the coverage of scenes whose largest stated error is small, as those that a
choice by stated error would pick.

Duration: seconds.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.stats import binomtest

from benchmarks.closed_form.scenes import SolvedScene, read_solved
from geometry.common.arrays import Bools, Floats
from solver.closed_form.designs import build_parameters
from solver.closed_form.error_quantile import (
    QUANTITIES,
    SCENE_CLASSES,
    TABLES,
    SceneClass,
    classify,
    compute_features,
    state_errors,
)
from solver.closed_form.evaluator import MAX_LOG_ERROR, ClosedForm, solve_columns

TABLES_FOLDER = Path(__file__).parents[2] / "solver" / "closed_form"
COVERAGE = 0.95
FIT_QUANTILE = 0.9  # of the regression: nearer to the middle than the quantile stated, as weights are surer there
FLOORS = dict.fromkeys(QUANTITIES, 1e-4) | {"log_sensitivity": 1e-6}  # errors below are all as good
SMOOTHING, RIDGE = 0.05, 1e-3  # of the regression's loss, and of its weights in standard deviations of the features
FOLDS = 10
SMALL_ERROR = 0.05  # largest stated error of scenes that a choice by stated error would pick
FEATURES_OF_TARGET = ("target",)  # features that only the log-sensitivity has
FEATURES_OF_LAYERS = ("softer layers", "squeezed layer")  # features that only layered scenes have


@dataclass(frozen=True)
class ErrorRow:
    """True errors of a solved scene, in the order of ``QUANTITIES``, NaN where unknown; its features and stated errors.

    ``searched`` is whether a search picked the scene.
    """

    kind: SceneClass
    features: dict[str, float]
    true: Floats
    stated: Floats | None
    searched: bool = False


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--seeds", type=int, nargs="+", help="what drew the scenes, for the record")
    parser.add_argument("--searched", type=Path, nargs="*", default=[], help="files of scenes that a search picked")
    options = parser.parse_args()
    rows = _read_rows(options.files, with_stated=not options.fit)
    if not options.fit:
        print_coverage(rows)
        return
    rows += [replace(row, searched=True) for row in _read_rows(options.searched, with_stated=False)]
    for file_name in sorted({TABLES[row.kind] for row in rows}):
        _write_table(file_name, [row for row in rows if TABLES[row.kind] == file_name], options.seeds)


def _write_table(file_name: str, rows: Sequence[ErrorRow], seeds: Sequence[int]) -> None:
    origin = {
        "script": "python -m benchmarks.closed_form.error FILE --fit",
        "date": date.today().isoformat(),
        "seeds": seeds,
        "scenes": dict(Counter(row.kind for row in rows if not row.searched)),
        "searched": dict(Counter(row.kind for row in rows if row.searched)),
    }
    TABLES_FOLDER.joinpath(file_name).write_text(json.dumps({"origin": origin, **fit(rows)}, indent=1) + "\n", encoding="utf-8")


def _read_rows(files: Sequence[Path], *, with_stated: bool) -> list[ErrorRow]:
    solved = [item for file in files for item in read_solved(file)]
    return [row for item in solved if (row := build_row(item, with_stated=with_stated)) is not None]


def build_row(solved: SolvedScene, *, with_stated: bool = True) -> ErrorRow | None:
    """Return the errors of a scene; None where it is refused, the formulas break down, or its stated error is too large."""
    if ClosedForm().refusal(solved.scene) is not None:
        return None
    shape, values = build_parameters(solved.scene)
    columns = values[:, None]
    products, derivatives = (part[:, :2] for part in solve_columns(shape, columns)[:2])
    forces, derivative = products[0], derivatives[0]
    if not (np.all(np.isfinite(forces)) and np.all(forces.sum(axis=1) > 0)):
        return None
    features = {name: float(value[0]) for name, value in compute_features(shape, columns, products, derivatives).items()}
    stated = None
    if with_stated:
        stated = state_errors(shape, columns, products, derivatives)[0]
        if stated[:-1].max() > MAX_LOG_ERROR:
            return None
    return ErrorRow(classify(shape), features, _compute_true(solved, forces, derivative), stated)


def _compute_true(solved: SolvedScene, forces: Floats, derivative: Floats) -> Floats:
    """Return the errors of ln(ratio), of the logarithms of totals and stiffness, and of the log-sensitivity."""
    probe, result = solved.scene.probe, solved.result
    film_forces = np.array([result["stress_inner"], result["stress_outer"]], dtype=float) * [probe.inner_area, probe.outer_area]
    totals = forces.sum(axis=1)
    exact = film_forces * float(result["stiffness"] or 0.0) / film_forces.sum()
    with np.errstate(invalid="ignore"):
        wrong = np.nan_to_num(np.log(totals / exact), nan=math.inf)  # a total of the other sign
    share, known = derivative.sum(axis=1) / totals, result["log_sensitivity"]
    sensitivity = math.nan if known is None else abs(float(share[0] - share[1]) - known)
    stiffness = abs(math.log(float(totals.sum()) / float(exact.sum())))
    return np.array([abs(wrong[0] - wrong[1]), *np.abs(wrong), stiffness, sensitivity])


def fit(rows: Sequence[ErrorRow]) -> dict[str, dict[str, dict[str, float]]]:
    """Return the weights by quantity and feature, and the constants by class and quantity, three digits."""
    classes = [kind for kind in SCENE_CLASSES if any(row.kind == kind for row in rows)]
    kinds, drawn = np.array([row.kind for row in rows]), np.array([not row.searched for row in rows])
    weights: dict[str, dict[str, float]] = {}
    constants: dict[str, dict[str, float]] = {kind: {} for kind in classes}
    for place, quantity in enumerate(QUANTITIES):
        unused = (() if quantity == "log_sensitivity" else FEATURES_OF_TARGET) + (
            () if "layered" in classes else FEATURES_OF_LAYERS
        )
        used = [name for name in rows[0].features if name not in unused]
        table, true = (
            np.array([[row.features[name] for name in used] for row in rows]),
            np.array([row.true[place] for row in rows]),
        )
        known = np.isfinite(true)
        features, logs = table[known], np.log(true[known] + FLOORS[quantity])
        fitted = np.array([float(f"{weight:.3g}") for weight in regress(features, logs, kinds[known], classes)])
        weights[quantity] = dict(zip(used, fitted.tolist(), strict=True))
        shift = calibrate(features, np.log(true[known]), logs, kinds[known], drawn[known], classes)
        plain = logs - features @ fitted
        for kind in classes:
            inside = drawn[known] & (kinds[known] == kind)
            constants[kind][quantity] = float(f"{np.quantile(plain[inside], FIT_QUANTILE) + shift[kind]:.4g}")
    return {"weights": weights, "constants": constants}


def regress(features: Floats, logs: Floats, kinds: Floats, classes: Sequence[SceneClass], ridge: float = RIDGE) -> Floats:
    """Return the weights of a quantile regression of logarithms of errors, with a constant for each class."""
    middle, width = features.mean(axis=0), features.std(axis=0)
    columns = np.column_stack([(features - middle) / width, *(kinds == kind for kind in classes)])
    penalised = np.arange(columns.shape[1]) < features.shape[1]

    def compute_loss(weights: Floats) -> tuple[float, Floats]:
        left = logs - columns @ weights
        size = np.sqrt(left**2 + SMOOTHING**2)  # the absolute value, smoothed
        penalty = ridge * np.where(penalised, weights, 0.0)
        loss = (size / 2 + (FIT_QUANTILE - 0.5) * left).mean() + float(penalty @ weights)
        return loss, 2 * penalty - (left / size / 2 + FIT_QUANTILE - 0.5) @ columns / len(left)

    start = np.where(penalised, 0.0, np.quantile(logs, FIT_QUANTILE))
    solution: Floats = minimize(compute_loss, start, jac=True, method="L-BFGS-B").x
    return np.asarray(solution[: features.shape[1]] / width)


def calibrate(
    features: Floats,
    true: Floats,
    logs: Floats,
    kinds: Floats,
    drawn: Bools,
    classes: Sequence[SceneClass],
    ridge: float = RIDGE,
) -> dict[str, float]:
    """Return for each class what its constant needs above the quantile of the regression, so that ``COVERAGE`` is covered.

    The logarithms ``true`` of errors of a tenth of the scenes at a time are compared with those stated by the other scenes. The
    quantiles are those of the scenes as drawn.
    """
    folds, excess = np.random.default_rng(0).permutation(len(logs)) % FOLDS, np.empty(len(logs))
    for fold in range(FOLDS):
        fitted = folds != fold
        predicted = features @ regress(features[fitted], logs[fitted], kinds[fitted], classes, ridge)
        for kind in classes:
            inside = kinds == kind
            middle = np.quantile((logs - predicted)[fitted & inside & drawn], FIT_QUANTILE)
            excess[~fitted & inside] = (true - predicted)[~fitted & inside] - middle
    shifts: dict[str, float] = {}
    for kind in classes:
        sorted_excess = np.sort(excess[(kinds == kind) & drawn])
        rank = math.ceil(COVERAGE * (len(sorted_excess) + 1))
        shifts[kind] = float(sorted_excess[min(rank, len(sorted_excess)) - 1])
    return shifts


def print_rows(rows: Sequence[ErrorRow], kinds: Sequence[SceneClass], quantities: Sequence[str]) -> None:
    """Print the table of coverage by class and quantity."""
    print("| class | quantity | scenes | covered | interval | median true | median stated | stated/true | largest true/stated |")
    print("|---|---|---|---|---|---|---|---|---|")
    for kind in kinds:
        for place, quantity in enumerate(quantities):
            true, stated = select_errors(rows, kind, place)
            if len(true):
                medians, covered = (np.median(true), np.median(stated)), int((true <= stated).sum())
                interval = binomtest(covered, len(true)).proportion_ci()
                print(
                    f"| {kind} | {quantity} | {len(true)} | {covered / len(true):.1%} "
                    f"| {interval.low:.1%} to {interval.high:.1%} | {medians[0]:.2g} | {medians[1]:.2g} "
                    f"| {medians[1] / medians[0]:.1f} | {np.max(true / stated):.2g} |"
                )


def print_coverage(rows: Sequence[ErrorRow]) -> None:
    """Print the table of coverage, and that of scenes with small stated errors."""
    print_rows(rows, SCENE_CLASSES, QUANTITIES)
    small = [row for row in rows if row.stated is not None and row.stated[:4].max() <= SMALL_ERROR]
    coverages = [f"{quantity} {_count_covered(small, place):.1%}" for place, quantity in enumerate(QUANTITIES)]
    print(f"covered where all stated errors are at most {SMALL_ERROR:.0%}, {len(small)} scenes: {', '.join(coverages)}")


def select_errors(rows: Sequence[ErrorRow], kind: SceneClass, place: int) -> tuple[Floats, Floats]:
    """Return the known true errors of a quantity in a class, and those stated."""
    pairs = [(row.true[place], row.stated[place]) for row in rows if row.kind == kind and row.stated is not None]
    true, stated = np.array(pairs).reshape(-1, 2).T
    known: Bools = ~np.isnan(true)
    return true[known], stated[known]


def _count_covered(rows: Sequence[ErrorRow], place: int) -> float:
    pairs = [(row.true[place], row.stated[place]) for row in rows if row.stated is not None and not math.isnan(row.true[place])]
    return float(np.mean([true <= stated for true, stated in pairs])) if pairs else math.nan


if __name__ == "__main__":
    main()
