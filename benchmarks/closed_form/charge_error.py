"""Fit the closed form's stated errors of charges, and measure how many true errors they cover.

``python -m benchmarks.closed_form.charge_error FILE... --fit --seeds K...`` fits them to scenes of files of ``film_scenes.py``,
drawn with these seeds, as ``error.py`` does those of forces, and writes ``solver/closed_form/charge_error_quantiles.json``.
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

import numpy as np

from benchmarks.closed_form.error import COVERAGE, FIT_QUANTILE, ErrorRow, calibrate, print_rows, regress
from benchmarks.closed_form.film_scenes import ChargedScene, read_charged
from geometry import InputError
from solver.closed_form.charge_errors import CHARGE_QUANTITIES, compute_charge_features, state_charge_errors
from solver.closed_form.designs import build_parameters
from solver.closed_form.error_quantile import CHARGE_CLASSES, classify
from solver.closed_form.evaluator import ClosedForm, solve_columns

TABLE = Path(__file__).parents[2] / "solver" / "closed_form" / "charge_error_quantiles.json"
FLOORS = dict.fromkeys(CHARGE_QUANTITIES, 1e-3) | {"charge_log_sensitivity": 1e-6}  # errors below are all as good
MAX_TRUE_ERROR = 5.0  # of the regression: charges of the other sign are as bad as can be
MIN_ERROR = 1e-300  # in place of errors of zero, which have no logarithm
SENSITIVITY_FEATURES = ("target",)  # features that only the log-sensitivity has
INNER, OUTER = "inner", "outer"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--recalibrate", action="store_true")
    parser.add_argument("--seeds", type=int, nargs="+", help="what drew the scenes, for the record")
    options = parser.parse_args()
    solved = [item for file in options.files for item in read_charged(file)]
    rows = [row for item in solved if (row := build_charge_row(item, with_stated=not options.fit)) is not None]
    if options.recalibrate:
        document = json.loads(TABLE.read_text(encoding="utf-8"))
        for kind in sorted({row.kind for row in rows}):
            drawn = [row for row in rows if row.kind == kind]
            document["constants"][kind] = recalibrate(drawn, document["weights"], document["constants"][kind])
            note = {"date": date.today().isoformat(), "seeds": options.seeds, "scenes": len(drawn)}
            document["origin"].setdefault("recalibrated", {})[kind] = note
        TABLE.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        return
    if not options.fit:
        print_rows(rows, CHARGE_CLASSES, CHARGE_QUANTITIES)
        return
    origin = {
        "script": "python -m benchmarks.closed_form.charge_error FILE --fit",
        "date": date.today().isoformat(),
        "seeds": options.seeds,
        "scenes": dict(Counter(row.kind for row in rows)),
    }
    TABLE.write_text(json.dumps({"origin": origin, **fit(rows)}, indent=1) + "\n", encoding="utf-8")


def build_charge_row(solved: ChargedScene, *, with_stated: bool = True) -> ErrorRow | None:
    """Return the errors of a scene's charges; None where the closed form refuses it."""
    scene, evaluator = solved.scene, ClosedForm()
    if evaluator.refusal(scene) is not None:
        return None
    shape, values = build_parameters(scene)
    products, derivatives = (part[0] for part in solve_columns(shape, values[:, None])[:2])
    if not (np.all(np.isfinite(products)) and np.all(products[:2].sum(axis=1) > 0)):
        return None
    stated = None
    if with_stated:
        if isinstance(evaluator.compute_films([scene])[0], InputError):
            return None
        errors = state_charge_errors(scene, shape, values, products, derivatives)
        stated = np.array([errors.log_ratio, *errors.log_totals, errors.sensitivity])
    features = compute_charge_features(scene, shape, values, products, derivatives)
    charges, exact = products[2:].sum(axis=1), solved.result
    true = np.array([exact["charge_inner"], exact["charge_outer"]]) / (scene.load.indentation or math.nan)
    quotient = true[0] / true[1] * charges[1] / charges[0]
    ratio = abs(math.log(quotient)) if quotient > 0 else math.inf  # a charge of the other sign
    share = derivatives[2:].sum(axis=1) / charges
    sensitivity = abs(float(share[0] - share[1]) - exact["charge_log_sensitivity"])
    return ErrorRow(classify(shape), features, np.array([ratio, *np.abs(true / charges - 1), sensitivity]), stated)


def fit(rows: Sequence[ErrorRow]) -> dict[str, dict[str, dict[str, float]]]:
    """Return the weights by quantity and feature, and the constants by class and quantity."""
    kinds, drawn = np.array([row.kind for row in rows]), np.ones(len(rows), dtype=bool)
    weights: dict[str, dict[str, float]] = {}
    constants: dict[str, dict[str, float]] = {kind: {} for kind in CHARGE_CLASSES}
    for place, quantity in enumerate(CHARGE_QUANTITIES):
        used = [name for name in rows[0].features if _concerns(quantity, name)]
        features = np.array([[row.features[name] for name in used] for row in rows])
        true = np.array([row.true[place] for row in rows])
        logs = np.log(np.minimum(true, MAX_TRUE_ERROR) + FLOORS[quantity])
        fitted = np.array([float(f"{weight:.3g}") for weight in regress(features, logs, kinds, CHARGE_CLASSES)])
        weights[quantity] = dict(zip(used, fitted.tolist(), strict=True))
        shift = calibrate(features, np.log(true), logs, kinds, drawn, CHARGE_CLASSES)
        plain = logs - features @ fitted
        for kind in CHARGE_CLASSES:
            constants[kind][quantity] = float(f"{np.quantile(plain[kinds == kind], FIT_QUANTILE) + shift[kind]:.4g}")
    return {"weights": weights, "constants": constants}


def recalibrate(rows: Sequence[ErrorRow], weights: dict[str, dict[str, float]], constants: dict[str, float]) -> dict[str, float]:
    """Return the constants of one class with which ``COVERAGE`` of the next scene's errors are covered, weights unchanged.

    Parameters
    ----------
    rows
        Scenes of the class that had no part in the fit, with the errors stated by the present constants.
    weights, constants
        Of the present table: by quantity and feature, and by quantity.
    """
    moved, rank = {}, min(math.ceil(COVERAGE * (len(rows) + 1)), len(rows))
    for place, quantity in enumerate(CHARGE_QUANTITIES):
        needed = []  # constants with which each error is as stated
        for row in rows:
            plain = sum(weight * row.features[name] for name, weight in weights[quantity].items())
            assert row.stated is not None
            added = row.stated[place] - math.exp(plain + constants[quantity])  # by glue and details
            needed.append(math.log(max(row.true[place] - added, MIN_ERROR)) - plain)
        moved[quantity] = float(f"{sorted(needed)[rank - 1]:.4g}")
    return moved


def _concerns(quantity: str, feature: str) -> bool:
    """Return whether a quantity's error depends on a feature: the other film's do not, nor does a target for charges."""
    if feature in SENSITIVITY_FEATURES:
        return quantity == "charge_log_sensitivity"
    other = {"charge_inner": OUTER, "charge_outer": INNER}.get(quantity)
    return other is None or not feature.endswith(f" {other}")


if __name__ == "__main__":
    main()
