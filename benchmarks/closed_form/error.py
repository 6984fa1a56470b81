"""The closed form's stated errors: where their weights come from, and how they do on other scenes.

``python -m benchmarks.closed_form.error FILE --seeds 1:1000`` audits: for the scenes of a file of ``scenes.py``, of which the
seeds drew as many as said, it prints quantiles of the true errors of ln(ratio), of the logarithms of both totals and of the
log-sensitivity, of the stated ones, and of true over stated, which must stay below 1, and writes them to
``solver/closed_form/error_weights.json``. With ``--fit`` it writes the weights of eq. CF.19 instead (``envelope.py``), such that
no scene of the file or of tests/reference is stated less than ``ERROR_MARGIN_FACTOR`` times its error, or than its error with
that of the converged result.

Duration: a minute.
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

from benchmarks.closed_form.envelope import compute_weights
from benchmarks.closed_form.scenes import read_answers
from geometry import Scene, read_scene
from geometry.common.arrays import Floats
from solver.closed_form.designs import build_parameters
from solver.closed_form.error_bound import BOUNDED_QUANTITIES, MIN_SENSITIVITY_ERROR, bound_errors
from solver.closed_form.error_features import FEATURE_NAMES, compute_features
from solver.closed_form.evaluator import MAX_LOG_RATIO_ERROR, ClosedForm, compute_variants

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "tests" / "reference"
WEIGHTS = ROOT / "solver" / "closed_form" / "error_weights.json"
FOLDERS = ("axisymmetric", "extra", "extreme", "extremes", "half-space", "off-axis", "solid", "layers", "tissue-layers")
ERROR_MARGIN_FACTOR = 2.0
QUANTILE_LEVELS = (0.1, 0.5, 0.9, 0.99, 1.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--seeds", nargs="+", required=True, metavar="SEED:SCENES", help="what drew the scenes of the file")
    options = parser.parse_args()
    scenes = list(read_answers(options.file))
    seeds = {seed: int(number) for seed, number in (drawn.split(":") for drawn in options.seeds)}
    if sum(seeds.values()) != len(scenes):
        parser.error(f"--seeds add up to {sum(seeds.values())} scenes, the file holds {len(scenes)}")
    drawn = {"date": date.today().isoformat(), "scenes": len(scenes), "seeds": seeds}
    if options.fit:
        origin = {"script": "python -m benchmarks.closed_form.error FILE --fit"} | drawn
        document = {"origin": origin | {"references": FOLDERS, "margin": ERROR_MARGIN_FACTOR}, "weights": fit(scenes)}
    else:
        document = json.loads(WEIGHTS.read_text(encoding="utf-8")) | {"audit": drawn | audit(list(rows(scenes)))}
    WEIGHTS.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def references() -> Iterator[tuple[Scene, dict[str, Any]]]:
    """Yield the plain scenes of tests/reference that the closed form takes, with their answers."""
    for folder in FOLDERS:
        for name, values in json.loads((REFERENCE / folder / "expected.json").read_text()).items():
            scene = read_scene(REFERENCE / folder / f"{name}.toml")
            if scene.probe.groove is None and ClosedForm().refusal(scene) is None:
                keys = {"stress_inner": "stress_inner_pa", "stress_outer": "stress_outer_pa", "stiffness": "stiffness_n_per_m"}
                answer = {key: values[old] for key, old in keys.items()}
                yield scene, answer | {"log_sensitivity": values.get("log_sensitivity"), "error_estimate": 0.0}


@dataclass(frozen=True)
class JudgedScene:
    """A scene's features, true and stated errors by the names of ``QUANTITIES``; no error of a sensitivity that is not known.

    Attributes:
        features: values of ``FEATURES``, shape (10, 4).
        true: what the formulas are off by from the converged answer.
        stated: by eq. CF.19.
        unsure: the converged answer's own stated error.
        layered: whether the tissue has layers.
    """

    features: Floats
    true: dict[str, float]
    stated: dict[str, float]
    unsure: float
    layered: bool


def rows(scenes: list[tuple[Scene, dict[str, Any]]]) -> Iterator[JudgedScene]:
    """Yield those of the scenes that the closed form takes and for which the formulas give totals above zero."""
    for scene, answer in scenes:
        if ClosedForm().refusal(scene) is not None:
            continue
        shape, values = build_parameters(scene)
        forces, slopes, _ = (part[0] for part in compute_variants(shape, [values]))
        if not (np.all(np.isfinite(forces)) and np.all(forces.sum(axis=2) > 0)):
            continue
        bounds, features = bound_errors(scene, forces, slopes), compute_features(scene, forces, slopes)
        true = zip(BOUNDED_QUANTITIES, _true(scene, answer, forces[0], slopes[0]), strict=True)
        stated = bounds.log_ratio, *map(float, bounds.log_totals), bounds.sensitivity
        yield JudgedScene(
            np.array([features[name] for name in FEATURE_NAMES]),
            {name: error for name, error in true if error is not None},
            dict(zip(BOUNDED_QUANTITIES, stated, strict=True)),
            unsure=answer["error_estimate"],
            layered=bool(scene.tissue.layer),
        )


def _true(scene: Scene, answer: dict[str, Any], forces: Floats, slope: Floats) -> tuple[float | None, ...]:
    """Errors of ln(ratio), of the logarithms of both totals and of the log-sensitivity."""
    totals = forces.sum(axis=1)
    felt = np.array([answer["stress_inner"], answer["stress_outer"]]) * [scene.probe.inner_area, scene.probe.outer_area]
    exact = felt * answer["stiffness"] / felt.sum()
    wrong = np.log(totals / np.where(exact > 0, exact, totals * np.exp(-MAX_LOG_RATIO_ERROR)))  # another sign is to be refused
    share, known = slope.sum(axis=1) / totals, answer["log_sensitivity"]
    sensitivity = None if known is None or scene.target is None else abs(float(share[0] - share[1]) - known)
    return abs(float(wrong[0] - wrong[1])), *map(float, np.abs(wrong)), sensitivity


def fit(scenes: list[tuple[Scene, dict[str, Any]]]) -> dict[str, dict[str, float]]:
    """Return the weights above zero by quantity and feature."""
    judged = list(rows(scenes + list(references())))
    return {
        kind: _fit_quantity(place, kind, [row for row in judged if kind in row.true])
        for place, kind in enumerate(BOUNDED_QUANTITIES)
    }


def _fit_quantity(place: int, kind: str, known: list[JudgedScene]) -> dict[str, float]:
    true = np.array([row.true[kind] for row in known])
    lower_bound = ERROR_MARGIN_FACTOR * true - MIN_SENSITIVITY_ERROR
    if kind != "sensitivity":
        lower_bound = np.minimum(
            np.maximum(ERROR_MARGIN_FACTOR * true, true + [row.unsure for row in known]), MAX_LOG_RATIO_ERROR
        )
    weights = compute_weights(
        np.array([row.features[:, place] for row in known]), np.maximum(lower_bound, 0.0), np.median(true) / 10
    )
    return {name: float(f"{weight:.3g}") for name, weight in zip(FEATURE_NAMES, weights, strict=True) if weight > 0}


def audit(judged: list[JudgedScene]) -> dict[str, Any]:
    """Print and return quantiles over those that are not refused, and over those of layers."""
    kept = [row for row in judged if row.stated["ratio"] <= MAX_LOG_RATIO_ERROR]
    layered = [row for row in kept if row.layered]
    print(f"{len(judged)} scenes, {len(judged) - len(kept)} refused, {len(layered)} of the others layered")
    counts = {"answered": len(kept), "refused": len(judged) - len(kept), "layered": len(layered), "shares": QUANTILE_LEVELS}
    return counts | {"all": _quantiles("", kept), "layers": _quantiles("layered, ", layered)}


def _quantiles(which: str, judged: list[JudgedScene]) -> dict[str, Any]:
    summary: dict[str, Any] = {}
    for kind in BOUNDED_QUANTITIES:
        known = [row for row in judged if kind in row.true]
        true, stated = (np.array([getattr(row, name)[kind] for row in known]) for name in ("true", "stated"))
        summary[kind] = {"scenes": len(known), "above": int((true > stated).sum())}
        for text, values in (("true", true), ("stated", stated), ("true over stated", true / stated)):
            quantiles = [float(f"{value:.3g}") for value in np.quantile(values, QUANTILE_LEVELS)] if known else []
            summary[kind][text] = quantiles
            listed = ", ".join(f"{share:.0%} {value:.3g}" for share, value in zip(QUANTILE_LEVELS, quantiles, strict=False))
            print(f"{which}{kind}, {len(known)} scenes, {text}: {listed}")
    return summary


if __name__ == "__main__":
    main()
