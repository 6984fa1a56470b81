"""The report of `check`: each table below what a terminal says above it."""

from __future__ import annotations

from probe_design.reporting.page import Text
from probe_design.reporting.table import Table
from probe_design.terminal.check_report import show_below_title


def test_a_table_stands_below_its_title_and_an_empty_one_nowhere() -> None:
    title, headings = "passed: chi-square 3.2", ("name", "z")
    assert show_below_title(Table(headings, (), title)) == ()
    table = Table(headings, (("block of 3 kPa", "0.82"),), title)
    assert show_below_title(table) == (Text("Passed: chi-square 3.2:"), table)
