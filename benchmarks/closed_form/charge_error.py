"""Fit the closed form's stated errors of charges, and measure how many true errors they cover.

``python -m benchmarks.closed_form.charge_error FILE... --fit --seeds K...`` fits them to scenes of files of ``film_scenes.py``,
drawn with these seeds, as ``error.py`` does those of forces, and writes ``solver/closed_form/charge_error_quantiles.json``.
Without ``--fit`` it prints, for scenes drawn with another seed, how many true errors the stated ones cover by class and quantity.

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

from benchmarks.closed_form.error import FIT_QUANTILE, ErrorRow, calibrate, print_rows, regress
from benchmarks.closed_form.film_scenes import ChargedScene, read_charged
from geometry import InputError
from solver.closed_form.charge_errors import CHARGE_QUANTITIES, compute_charge_features, state_charge_errors
from solver.closed_form.designs import build_parameters
from solver.closed_form.error_quantile import CHARGE_CLASSES, classify
from solver.closed_form.evaluator import ClosedForm, solve_columns

TABLE = Path(__file__).parents[2] / "solver" / "closed_form" / "charge_error_quantiles.json"
FLOORS = dict.fromkeys(CHARGE_QUANTITIES, 1e-3) | {"charge_log_sensitivity": 1e-6}  # errors below are all as good
MAX_TRUE_ERROR = 5.0  # of the regression: charges of the other sign are as bad as can be
SENSITIVITY_FEATURES = ("target",)  # features that only the log-sensitivity has
INNER, OUTER = "inner", "outer"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--seeds", type=int, nargs="+", help="what drew the scenes, for the record")
    options = parser.parse_args()
    solved = [item for file in options.files for item in read_charged(file)]
    rows = [row for item in solved if (row := build_charge_row(item, with_stated=not options.fit)) is not None]
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


def _concerns(quantity: str, feature: str) -> bool:
    """Return whether a quantity's error depends on a feature: the other film's do not, nor does a target for charges."""
    if feature in SENSITIVITY_FEATURES:
        return quantity == "charge_log_sensitivity"
    other = {"charge_inner": OUTER, "charge_outer": INNER}.get(quantity)
    return other is None or not feature.endswith(f" {other}")


if __name__ == "__main__":
    main()
