"""The report of `check`: each table below what a terminal says above it."""

from __future__ import annotations

import pytest

from probe_design.probe_check.explanations import Explanation
from probe_design.reporting.page import Text
from probe_design.reporting.table import Table
from probe_design.terminal.check_report import show_below_title
from probe_design.terminal.hardware_tables import _format_explanation


def test_a_table_stands_below_its_title_and_an_empty_one_nowhere() -> None:
    title, headings = "passed: chi-square 3.2", ("name", "z")
    assert show_below_title(Table(headings, (), title)) == ()
    table = Table(headings, (("block of 3 kPa", "0.82"),), title)
    assert show_below_title(table) == (Text("Passed: chi-square 3.2:"), table)


@pytest.mark.parametrize(
    ("variable", "nominal", "change", "sd", "texts"),
    [
        ("probe.inner.youngs_modulus", 1e6, -133.4e3, 262e3, ("1 MPa", "866.6 kPa", "260 kPa")),
        ("probe.gap", 1e-4, 2e-5, 1.234e-5, ("0.1 mm", "0.12 mm", "0.012 mm")),
        ("probe.film.d33", -20e-12, 2e-12, 1.02e-12, ("-20 pC/N", "-18 pC/N", "1 pC/N")),
        ("probe.inner.poisson_ratio", 0.48, -0.1052, 0.2, ("0.48", "0.3748", "0.2")),
        ("relative gain", 1.0, 0.0192, 0.05, ("1", "1.019", "0.05")),
    ],
)
def test_what_would_explain_a_deviation_has_its_unit(
    variable: str, nominal: float, change: float, sd: float, texts: tuple[str, ...]
) -> None:
    assert _format_explanation(Explanation(variable, change, sd, nominal, 1.0, 0.5, True)) == texts
