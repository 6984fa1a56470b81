"""The stated errors: ten features at most, weights and audit with an origin, and no true error above what is stated."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from benchmarks.closed_form.error import QUANTILE_LEVELS, JudgedScene, references, rows
from benchmarks.closed_form.random_scenes import draw
from geometry import InputError, Scene, read_scene
from solver import evaluate
from solver.closed_form.block_compliance import ElasticBlocks
from solver.closed_form.contact import Tissue, solve_contact
from solver.closed_form.error_bound import BOUNDED_QUANTITIES, read_weights
from solver.closed_form.error_features import ALL_VARIANTS, FEATURE_NAMES, compute_features
from solver.closed_form.evaluator import MAX_LOG_RATIO_ERROR, ClosedForm
from tests.support.named import runs
from tests.support.paths import ROOT, SCENE
from tests.support.slow import slow_unless

FILE = json.loads((ROOT / "solver" / "closed_form" / "error_weights.json").read_text(encoding="utf-8"))


def test_ten_features_at_most_and_weights_of_these() -> None:
    forces = np.ones((len(ALL_VARIANTS), 2, 2))
    feature_values = compute_features(read_scene(SCENE), forces, forces)
    assert tuple(feature_values) == FEATURE_NAMES
    assert len(FEATURE_NAMES) <= 10
    assert tuple(read_weights()) == BOUNDED_QUANTITIES
    for kind in BOUNDED_QUANTITIES:
        assert read_weights()[kind].keys() <= set(FEATURE_NAMES)
        assert all(0 < weight < math.inf for weight in read_weights()[kind].values())


def test_weights_tell_where_they_come_from() -> None:
    origin = FILE["origin"]
    assert runs(origin["script"].split()[2])
    assert origin["margin"] > 1
    assert origin["scenes"] == sum(origin["seeds"].values())
    assert {"date", "references"} <= origin.keys()


def test_audit_is_of_other_scenes_and_found_none_above() -> None:
    audit = FILE["audit"]
    assert not audit["seeds"].keys() & FILE["origin"]["seeds"].keys()
    assert sum(audit["seeds"].values()) >= audit["answered"] + audit["refused"]
    assert audit["shares"] == list(QUANTILE_LEVELS)
    for kind in BOUNDED_QUANTITIES:
        bound = audit["all"][kind]
        assert bound["scenes"] <= audit["answered"]
        assert bound["above"] == 0
        assert bound["true over stated"][-1] < 1


def is_below_bound(row: JudgedScene) -> bool:
    return row.stated["ratio"] > MAX_LOG_RATIO_ERROR or all(true <= row.stated[kind] for kind, true in row.true.items())


@pytest.mark.slow
def test_no_reference_is_above_its_bound() -> None:
    judged_rows = list(rows(list(references())))
    assert len(judged_rows) > 100
    assert all(is_below_bound(row) for row in judged_rows)


def fresh(seed: int) -> tuple[Scene, dict[str, Any]]:
    """A scene that neither fit nor audit drew, with the converged answer."""
    rng = np.random.default_rng([2026, seed])
    while True:
        try:
            scene = draw(rng)
            if ClosedForm().refusal(scene) is None and all(body.x == 0 for body in scene.inclusion):
                answer = evaluate(scene, "axisymmetric", 0.01)
                if answer.ratio is not None and not answer.warnings:
                    keys = ("stress_inner", "stress_outer", "stiffness", "log_sensitivity", "error_estimate")
                    return scene, {key: getattr(answer, key) for key in keys}
        except (InputError, ValueError):
            continue


@pytest.mark.parametrize("seed", slow_unless((3, 7).__contains__, range(12)))
def test_fresh_scenes_are_below_their_bounds(seed: int) -> None:
    assert all(is_below_bound(row) for row in rows([fresh(seed)]))


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_finer_functions_are_nearer_to_the_punch_of_boussinesq(share: float) -> None:
    """Stiff blocks without friction and next to no gap: 4 G a / (1 - nu), here 4 / 0.7."""
    ones = np.ones(1)

    def find_error(fine: bool) -> float:
        inner = ElasticBlocks(None, share * ones, ones, 1e9 * ones, 0 * ones, fine)
        outer = ElasticBlocks((share + 1e-6) * ones, ones, ones, 1e9 * ones, 0 * ones, fine)
        solution = solve_contact((inner, outer), Tissue(None, 2.6 * ones, 0.3 * ones), [], target=None, bonded=False, nodes=16)
        return abs(float(solution.forces.sum()) * 0.7 / 4 - 1)

    assert find_error(True) < 0.5 * find_error(False) < 2e-3
