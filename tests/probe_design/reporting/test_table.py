"""One description of a table: each form of it holds every cell, read back by another library."""

from __future__ import annotations

import csv
import io
import math
from xml.etree import ElementTree

import pytest
from markdown_it import MarkdownIt
from rich.console import Console

from probe_design.reporting.table import Table, format_number
from probe_design.terminal.whole_table import WholeTable

HEADINGS = ("quantity", "value")
ROWS = (("<b> & co", "1,5"), ("stiffness, N/m", "-"), ('a "quoted" sentence of more than 24 letters', "2"))
TABLE = Table(HEADINGS, ROWS, "title", "caption")


def test_html_holds_all_cells_and_marks_sentences() -> None:
    page = ElementTree.fromstring(TABLE.to_html())
    cells = [tuple(cell.text for cell in row) for row in page.iter("tr")]
    assert cells == [HEADINGS, *ROWS]
    assert [cell.get("class") for cell in page.iter("th")] == ["words", None]


def test_csv_reads_back() -> None:
    assert [tuple(row) for row in csv.reader(io.StringIO(TABLE.to_csv()))] == [HEADINGS, *ROWS]


@pytest.mark.parametrize(("keep_last", "shown"), [(False, ["0", "3", "6"]), (True, ["0", "3", "6"])])
def test_many_rows_are_thinned_evenly(keep_last: bool, shown: list[str]) -> None:
    table = Table.from_columns("", {"n": ([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0], 3)}, 3, keep_last=keep_last)
    assert [row[0] for row in table.rows] == shown


def test_the_first_or_the_last_row_is_kept() -> None:
    columns = {"n": ([float(k) for k in range(8)], 3), "none": ([None] * 8, 2)}
    assert [row[0] for row in Table.from_columns("", columns, 3).rows] == ["0", "3", "6"]
    assert [row[0] for row in Table.from_columns("", columns, 3, keep_last=True).rows] == ["1", "4", "7"]
    assert {row[1] for row in Table.from_columns("", columns, 8).rows} == {"-"}


def test_no_digits_of_what_is_no_number() -> None:
    assert [format_number(value, 3) for value in (None, math.nan, math.inf, 1234.5)] == ["-", "-", "-", "1.23e+03"]


def test_markdown_is_a_table() -> None:
    tokens = MarkdownIt("gfm-like", {"linkify": False}).parse(Table(("a", "b"), [("x|y<b>", "1")]).to_markdown())
    assert [token.content for token in tokens if token.type == "inline"] == ["a", "b", "x&#124;y&lt;b&gt;", "1"]


def test_a_narrow_terminal_gets_thinner_lines() -> None:
    """Numbers stay whole; the frame goes first."""
    table = Table(("a", "b", "c", "d"), [("1.2345678", "2.3456789", "3.4567891", "4.5678912")])
    for width, frame in ((60, "│"), (44, " ")):
        console = Console(width=width, file=io.StringIO(), record=True, force_terminal=True)
        console.print(WholeTable(table))
        text = console.export_text()
        assert max(map(len, text.splitlines())) <= width
        assert all(cell in text for cell in table.rows[0])
        assert ("│" in text) == (frame == "│")
