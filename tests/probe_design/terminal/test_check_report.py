"""The report of `check`: each table below what a terminal says above it."""

from __future__ import annotations

from rich.table import Table

from probe_design.reports.page import PageTable, Text
from probe_design.terminal.check_report import convert_table


def test_a_table_stands_below_its_title_and_an_empty_one_nowhere() -> None:
    shown = Table("name", "z", title="passed: chi-square 3.2")
    assert convert_table(shown) == ()
    shown.add_row("block of 3 kPa", "0.82")
    assert convert_table(shown) == (
        Text("Passed: chi-square 3.2:"),
        PageTable(("name", "z"), (("block of 3 kPa", "0.82"),)),
    )
