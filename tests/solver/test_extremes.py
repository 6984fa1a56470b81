"""The extremes: no cell of the matrix is silently wrong; docs/evidence/extremes.md lists all of them.

True values are NGSolve's, or follow from them by laws of elasticity (tests/reference/README.md, tests/support/extremes/laws.py).
"""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from tests.support.extremes.cells import cells
from tests.support.extremes.classification import MARKS, classify, evaluate_row, find_flaws
from tests.support.extremes.rows import Truth, rows
from tests.support.paths import ROOT
from tests.support.program import run
from tests.support.slow import slow_unless

PAGE = (ROOT / "docs" / "evidence" / "extremes.md").read_text(encoding="utf-8")
ROWS = {row.key: row for row in rows()}
FAST = (  # the most extreme of each kind that take a second or two
    "contrast-1e-6", "contrast-1", "contrast-1e6-frictionless", "no-inclusion-hairline-gap", "incompressible", "zero-poisson",
    "gap-1-um-micro-probe", "gap-5-mm-micro-probe", "gap-4.5-mm-small-inner", "gap-5-mm-area-ratio-0.02",
    "cover-10-um-diameter-0.1-mm", "area-ratio-50", "micro-probe", "large-probe-diameter-50-mm-cover-10-um",
    "flat-incompressible", "tall-inner-flat-outer", "stiff-inner-soft-outer", "inner-neither-pressed-nor-pulled",
)  # fmt: skip
EXTREMES = [
    (f"extremes/{name}", evaluator) for name in FAST for evaluator in ("closed-form", "equivalent-inclusion", "axisymmetric")
]
LAWFUL = ("middle, 0 N", "middle, 0.1 N", "8 mm, 10 um deep, off the axis, of tissue", "contrast-1000, moduli times 1e+06")
LONG = [("extremes/inner-neither-pressed-nor-pulled", "axisymmetric"), ("extremes/gap-5-mm-micro-probe", "axisymmetric")]
LAWS = [(f"laws/{name}", evaluator) for name in LAWFUL for evaluator in ("closed-form", "equivalent-inclusion")]

QUICK = [cell for cell in EXTREMES[::4] + LAWS[::3] if cell not in LONG]  # each evaluator in turn


@pytest.mark.parametrize(("key", "evaluator"), slow_unless(QUICK.__contains__, EXTREMES + LAWS))
def test_right_refused_or_null_with_a_reason(key: str, evaluator: str) -> None:
    cell = classify(ROWS[key], evaluate_row(ROWS[key], evaluator))
    assert cell.mark != "wrong", cell.reason
    assert cell.mark == "right" or cell.reason


def test_document_lists_every_cell_and_none_is_wrong() -> None:
    all_cells = list(cells(list(ROWS.values())))
    totals = next(line for line in PAGE.splitlines() if line.startswith("| all |"))
    counts = dict(zip(MARKS, (int(number) for number in re.findall(r"\*\*(\d+)\*\*", totals)), strict=True))
    assert f"## {len(all_cells)} cells" in PAGE
    assert sum(counts.values()) == len(all_cells)
    assert counts["wrong"] == 0
    for row, _ in all_cells:
        assert f"| {row.name} |" in PAGE


def build_values(**changes: Any) -> dict[str, Any]:
    values = {"ratio": 1.0, "stress_inner": 1.0, "stress_outer": 1.0, "stiffness": 1.0, "log_sensitivity": 0.1}
    return values | {"error_estimate": 0.01, "warnings": ()} | changes


TRUTH = Truth(1.0, 1.0, 1.0, 1.0, 0.1)


@pytest.mark.parametrize(
    ("changes", "flaw"),
    [
        ({}, None),
        ({"ratio": 1.02}, "ratio in error by 0.02, stated 0.01"),
        ({"ratio": 1.02, "error_estimate": 0.03}, None),
        ({"stress_outer": 1.1}, "stress_outer in error by 0.1, stated 0.01"),
        ({"stress_outer": 1.1, "warnings": ("error bounds of 11 % reached, accuracy 1 % requested",)}, None),
        ({"stiffness": float("nan")}, "stiffness in error by nan, stated 0.01"),
        ({"log_sensitivity": 0.11}, "log_sensitivity 0.11, true 0.1 +- 0.005 stated"),
        ({"log_sensitivity": 0.11, "warnings": ("log_sensitivity is known within 20 % of its value",)}, None),
        ({"log_sensitivity": None}, "log_sensitivity is null without a reason"),
        ({"ratio": None, "error_estimate": None}, "ratio is null without a reason"),
    ],
)
def test_flaws_are_found(changes: dict[str, Any], flaw: str | None) -> None:
    assert list(find_flaws(build_values(**changes), TRUTH)) == ([] if flaw is None else [flaw])


@pytest.mark.parametrize(
    ("scene", "evaluator", "code"),
    [
        ("incompressible-contrast-1e-6", "auto", 0),
        ("gap-1-um-micro-probe", "axisymmetric", 0),
        ("inner-neither-pressed-nor-pulled", "equivalent-inclusion", 0),
        ("cover-10-um", "closed-form", 2),
    ],
)
def test_command_line_prints_json_or_one_line(scene: str, evaluator: str, code: int) -> None:
    path = ROOT / "tests" / "reference" / "extremes" / f"{scene}.toml"
    ended = run("evaluate", path, "--evaluator", evaluator, "--json")
    assert ended.returncode == code
    assert len(ended.stderr.splitlines()) == (1 if code else 0)
    if code == 0:
        output = json.loads(ended.stdout, parse_constant=pytest.fail)  # called for NaN and Infinity
        assert not list(find_flaws(output, ROWS[f"extremes/{scene}"].truth))
    else:
        assert ended.stdout == ""
