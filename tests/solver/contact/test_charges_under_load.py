"""Film charges under a hand's load through a skin, against finite strain by NGSolve with films and bonds meshed.

``tests/reference/contact/film_charges.json``; its README says how it was made.
"""

from __future__ import annotations

import json
from functools import cache

import pytest

from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene
from solver import Result, evaluate
from tests.support.paths import REFERENCE
from tests.support.slow import slow_unless

EXPECTED = json.loads((REFERENCE / "contact" / "film_charges.json").read_text(encoding="utf-8"))
ROWS = [(name, row["force"]) for name, case in EXPECTED.items() for row in case["rows"]]
QUICK = ("silicone blocks, tape to base", 0.1)
VALUES = ("charge_inner", "charge_outer", "charge_ratio")


def build(name: str, force: float) -> Scene:
    load = {"load": {"force": force}, "reading": {"observable": "charge"}}
    return Scene.from_tables(EXPECTED[name]["scene"] | load)


def get_row(name: str, force: float) -> JsonObject:
    return next(row for row in EXPECTED[name]["rows"] if row["force"] == force)


@cache
def press(name: str, force: float) -> Result:
    return evaluate(build(name, force), evaluator="contact")


@pytest.mark.parametrize("name", EXPECTED)
def test_light_loads_give_the_charges_of_another_code(name: str) -> None:
    force, expected = 1e-6, EXPECTED[name]["small_load"]
    result = evaluate(build(name, force), evaluator="axisymmetric", accuracy=1e-3, linear=True)
    assert result.charge_inner is not None
    assert result.charge_outer is not None
    assert result.charge_inner / force == pytest.approx(expected["charge_per_force_inner"], rel=1e-3)
    assert result.charge_outer / force == pytest.approx(expected["charge_per_force_outer"], rel=1e-3)
    assert result.charge_log_sensitivity == pytest.approx(expected["charge_log_sensitivity"], rel=2e-3)


@pytest.mark.parametrize(("name", "force"), slow_unless(QUICK.__eq__, ROWS))
def test_charges_under_load_are_those_of_another_code(name: str, force: float) -> None:
    row, result = get_row(name, force), press(name, force)
    for key in VALUES:
        value, error = getattr(result, key), getattr(result, f"{key}_error")
        assert value == pytest.approx(row[key], abs=error * abs(row[key]) + row[f"{key}_unc"])
        assert value == pytest.approx(row[key], abs=1e-2 * abs(row[key]) + row[f"{key}_unc"])
    key = "charge_log_sensitivity"
    value, error = result.charge_log_sensitivity, result.charge_log_sensitivity_error
    assert error is not None
    assert value == pytest.approx(row[key], abs=error + row[f"{key}_unc"])
    assert value == pytest.approx(row[key], abs=0.02 * abs(row[key]) + row[f"{key}_unc"])
