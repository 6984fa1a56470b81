"""Fit the closed form's stated errors of charges, and measure how many true errors they cover.

``python -m benchmarks.closed_form.charge_error FILE... --fit --seeds K...`` fits them to scenes of files of ``film_scenes.py``,
drawn with these seeds, as ``error.py`` does those of forces, and writes the tables of their classes, ``CHARGE_TABLES``. The
weights of layered scenes stay near those of the others, and a charge that nearly cancels has an error relative to its parts.
``--recalibrate`` keeps the weights and moves the constants of the scenes' classes alone, so that 95 % of them are covered.
Without both it prints, for scenes drawn with another seed, how many true errors the stated ones cover by class and quantity.

Duration: seconds.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import Counter
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.closed_form.error import COVERAGE, FIT_QUANTILE, RIDGE, TABLES_FOLDER, ErrorRow, calibrate, print_rows, regress
from benchmarks.closed_form.film_scenes import ChargedScene, read_charged
from geometry.common.arrays import Floats
from solver.closed_form.charge_errors import (
    CHARGE_QUANTITIES,
    CHARGE_TABLES,
    add_glue_to_ratio,
    compute_charge_features,
    state_charge_errors,
)
from solver.closed_form.designs import build_parameters
from solver.closed_form.error_quantile import CHARGE_CLASSES, classify, read_quantiles
from solver.closed_form.evaluator import ClosedForm, SolvedArrays

FLOORS = dict.fromkeys(CHARGE_QUANTITIES, 1e-3) | {"charge_log_sensitivity": 1e-6}  # errors below are all as good
MAX_TRUE_ERROR = 5.0  # of the regression: charges of the other sign are as bad as can be
MIN_ERROR = 1e-300  # in place of errors of zero, which have no logarithm
SENSITIVITY_FEATURES = ("target",)  # features that only the log-sensitivity has
INNER, OUTER = "inner", "outer"
LAYERED_RIDGE = 0.03  # on how far the weights of layered scenes are from those of the others
CANCELLED = "cancelled"  # features whose weight is 1
GLUE = "floating glue"  # features of layered scenes, whose errors are stated with what glue adds
LAYERED_FEATURES = ("softer layers", "squeezed layer", GLUE, CANCELLED)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--recalibrate", action="store_true")
    parser.add_argument("--seeds", type=int, nargs="+", help="what drew the scenes, for the record")
    options = parser.parse_args()
    solved = [item for file in options.files for item in read_charged(file)]
    rows = [row for item in solved if (row := build_charge_row(item, with_stated=not options.fit)) is not None]
    if not (options.fit or options.recalibrate):
        print_rows(rows, CHARGE_CLASSES, CHARGE_QUANTITIES)
        return
    for file_name in sorted({CHARGE_TABLES[row.kind] for row in rows}):
        drawn = [row for row in rows if CHARGE_TABLES[row.kind] == file_name]
        path = TABLES_FOLDER / file_name
        document = _fit_table(drawn, options.seeds) if options.fit else _recalibrate_table(path, drawn, options.seeds)
        path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _fit_table(rows: Sequence[ErrorRow], seeds: Sequence[int]) -> dict[str, Any]:
    """Return weights and constants of the scenes' classes, with their origin."""
    origin = {
        "script": "python -m benchmarks.closed_form.charge_error FILE --fit",
        "date": date.today().isoformat(),
        "seeds": seeds,
        "scenes": dict(Counter(row.kind for row in rows)),
    }
    return {"origin": origin, **fit(rows)}


def _recalibrate_table(path: Path, rows: Sequence[ErrorRow], seeds: Sequence[int]) -> dict[str, Any]:
    """Return the table with other constants of the scenes' classes."""
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    for kind in sorted({row.kind for row in rows}):
        drawn = [row for row in rows if row.kind == kind]
        document["constants"][kind] = recalibrate(drawn, document["weights"], document["constants"][kind])
        note = {"date": date.today().isoformat(), "seeds": seeds, "scenes": len(drawn)}
        document["origin"].setdefault("recalibrated", {})[kind] = note
    return document


def build_charge_row(solved: ChargedScene, *, with_stated: bool = True) -> ErrorRow | None:
    """Return the errors of a scene's charges, NaN where the result is null; None where the closed form refuses the scene."""
    scene = solved.scene
    if ClosedForm().refusal(scene) is not None:
        return None
    shape, values = build_parameters(scene)
    arrays = SolvedArrays.from_values(shape, values[:, None])
    if not arrays.find_valid()[0]:
        return None
    products, derivatives = arrays.products[0], arrays.derivatives[0]
    features = compute_charge_features(scene, shape, values, products, derivatives)
    charges, exact = products[2:].sum(axis=1), solved.result
    true = np.array([exact["charge_inner"], exact["charge_outer"]]) / (scene.load.indentation or math.nan)
    quotient = true[0] / true[1] * charges[1] / charges[0]
    ratio = abs(math.log(quotient)) if quotient > 0 else math.inf  # a charge of the other sign
    share = derivatives[2:].sum(axis=1) / charges
    sensitivity = abs(float(share[0] - share[1]) - exact["charge_log_sensitivity"])
    wrong = np.array([ratio, *np.abs(true / charges - 1), sensitivity])
    stated = None
    if with_stated:
        errors = state_charge_errors(scene, shape, values, products, derivatives)
        stated = np.array([errors.log_ratio, *errors.log_totals, errors.sensitivity])
        null = errors.log_totals >= 1
        wrong[[null.any(), *null, null.any()]] = math.nan
    return ErrorRow(classify(shape), features, wrong, stated)


def fit(rows: Sequence[ErrorRow]) -> dict[str, dict[str, dict[str, float]]]:
    """Return the weights by quantity and feature, and the constants by class and quantity, of the classes of one table.

    Of layered scenes the errors fitted are those beyond what glue adds, and the ridge is on the weights' distance from those of
    the other classes.
    """
    classes = [kind for kind in CHARGE_CLASSES if any(row.kind == kind for row in rows)]
    layered = "layered" in classes
    prior = read_quantiles(CHARGE_TABLES["bare"])["weights"] if layered else {quantity: {} for quantity in CHARGE_QUANTITIES}
    kinds, drawn = np.array([row.kind for row in rows]), np.ones(len(rows), dtype=bool)
    weights: dict[str, dict[str, float]] = {}
    constants: dict[str, dict[str, float]] = {kind: {} for kind in classes}
    for place, quantity in enumerate(CHARGE_QUANTITIES):
        used = [
            name for name in rows[0].features if _concerns(quantity, name) and (layered or not name.startswith(LAYERED_FEATURES))
        ]
        features = np.array([[row.features[name] for name in used] for row in rows])
        known = np.array([1.0 if name.startswith(CANCELLED) else prior[quantity].get(name, 0.0) for name in used])
        true = np.array([row.true[place] for row in rows])
        true = np.maximum(true - (_add_glue(rows, quantity) if layered else 0.0), MIN_ERROR)
        logs = np.log(np.minimum(true, MAX_TRUE_ERROR) + FLOORS[quantity]) - features @ known
        free = np.array([not name.startswith(CANCELLED) for name in used])
        ridge = LAYERED_RIDGE if layered else RIDGE
        changes = np.zeros(len(used))
        changes[free] = regress(features[:, free], logs, kinds, classes, ridge)
        fitted = np.array([float(f"{weight:.3g}") for weight in known + changes])
        weights[quantity] = dict(zip(used, fitted.tolist(), strict=True))
        shift = calibrate(features[:, free], np.log(true) - features @ known, logs, kinds, drawn, classes, ridge)
        plain = logs - features @ (fitted - known)
        for kind in classes:
            constants[kind][quantity] = float(f"{np.quantile(plain[kinds == kind], FIT_QUANTILE) + shift[kind]:.4g}")
    return {"weights": weights, "constants": constants}


def _add_glue(rows: Sequence[ErrorRow], quantity: str) -> Floats:
    """Return what ``state_charge_errors`` adds to a quantity's error for glue, shape (rows,)."""
    inner, outer = (np.array([row.features[f"{GLUE} {name}"] for row in rows]) for name in (INNER, OUTER))
    return {"charge_inner": inner, "charge_outer": outer, "charge_ratio": add_glue_to_ratio(inner, outer)}.get(
        quantity, 0 * inner
    )


def recalibrate(rows: Sequence[ErrorRow], weights: dict[str, dict[str, float]], constants: dict[str, float]) -> dict[str, float]:
    """Return the constants of one class with which ``COVERAGE`` of the next scene's errors are covered, weights unchanged.

    Parameters
    ----------
    rows
        Scenes of the class that had no part in the fit, with the errors stated by the present constants.
    weights, constants
        Of the present table: by quantity and feature, and by quantity.
    """
    moved = {}
    for place, quantity in enumerate(CHARGE_QUANTITIES):
        needed = []  # constants with which each error is as stated
        for row in rows:
            if math.isnan(row.true[place]):
                continue
            plain = sum(weight * row.features[name] for name, weight in weights[quantity].items())
            assert row.stated is not None
            added = row.stated[place] - math.exp(plain + constants[quantity])  # by glue and details
            needed.append(math.log(max(row.true[place] - added, MIN_ERROR)) - plain)
        rank = min(math.ceil(COVERAGE * (len(needed) + 1)), len(needed))
        moved[quantity] = float(f"{sorted(needed)[rank - 1]:.4g}")
    return moved


def _concerns(quantity: str, feature: str) -> bool:
    """Return whether a quantity's error depends on a feature: the other film's do not, nor does a target for charges."""
    if feature in SENSITIVITY_FEATURES:
        return quantity == "charge_log_sensitivity"
    if feature == CANCELLED:
        return quantity in ("charge_ratio", "charge_log_sensitivity")
    if feature.startswith(CANCELLED):
        return quantity == feature.replace(CANCELLED + " ", "charge_")
    other = {"charge_inner": OUTER, "charge_outer": INNER}.get(quantity)
    return other is None or not feature.endswith(f" {other}")


if __name__ == "__main__":
    main()
