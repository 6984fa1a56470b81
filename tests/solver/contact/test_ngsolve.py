"""Level contact against NGSolve's contact solver along a path: ratio, force, log-sensitivity and closest walls."""

from __future__ import annotations

import json

import pytest

from solver.contact.evaluator import ContactEvaluator
from tests.support.load_paths import FOLDER, scene_of

EXPECTED = json.loads((FOLDER / "ngsolve.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPECTED)
def test_the_path_of_another_code(name: str) -> None:
    scene = scene_of(name)
    path, areas = ContactEvaluator().prepare_scene(scene), scene.probe.outer_area / scene.probe.inner_area
    for row in EXPECTED[name]["rows"]:
        point = path.press_to_indentation(row["indentation"])
        inner, outer = point.films.totals * row["indentation"]
        slack = {key.removesuffix("_unc"): value for key, value in row.items() if key.endswith("_unc")}
        assert inner / outer * areas == pytest.approx(row["ratio"], abs=point.films.ratio_error * row["ratio"] + slack["ratio"])
        assert inner / outer * areas == pytest.approx(row["ratio"], abs=2e-3 * row["ratio"] + slack["ratio"])
        assert inner + outer == pytest.approx(row["force"], abs=1e-3 * row["force"] + slack["force"])
        log_sensitivity = row["log_sensitivity"]
        assert point.films.log_sensitivity == pytest.approx(
            log_sensitivity, abs=point.films.sensitivity_error + slack["log_sensitivity"]
        )
        assert point.point.walls == pytest.approx(row["closest_walls"], abs=1e-2 * row["closest_walls"] + slack["closest_walls"])
