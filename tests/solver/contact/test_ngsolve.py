"""Level contact against NGSolve's contact solver along a path: ratio, force, log-sensitivity and closest walls."""

from __future__ import annotations

import json

import pytest

from solver.contact.level import ContactLevel
from tests.support.load_paths import FOLDER, scene_of

EXPECTED = json.loads((FOLDER / "ngsolve.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPECTED)
def test_the_path_of_another_code(name: str) -> None:
    scene = scene_of(name)
    on, areas = ContactLevel().pressed(scene), scene.probe.outer_area / scene.probe.inner_area
    for row in EXPECTED[name]["rows"]:
        found = on.at_indentation(row["indentation"])
        inner, outer = found.films.totals * row["indentation"]
        slack = {key.removesuffix("_unc"): value for key, value in row.items() if key.endswith("_unc")}
        assert inner / outer * areas == pytest.approx(row["ratio"], abs=found.films.ratio_error * row["ratio"] + slack["ratio"])
        assert inner / outer * areas == pytest.approx(row["ratio"], abs=2e-3 * row["ratio"] + slack["ratio"])
        assert inner + outer == pytest.approx(row["force"], abs=1e-3 * row["force"] + slack["force"])
        told = row["log_sensitivity"]
        assert found.films.log_sensitivity == pytest.approx(told, abs=found.films.sensitivity_error + slack["log_sensitivity"])
        assert found.point.walls == pytest.approx(row["closest_walls"], abs=1e-2 * row["closest_walls"] + slack["closest_walls"])
