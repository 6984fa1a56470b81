"""What tables print of limits, in terminals of any width; names that are not for terminals."""

from __future__ import annotations

from dataclasses import replace
from io import StringIO

import pytest
from rich.console import Console

from geometry import read_scene
from probe_design.reporting.table import Table
from probe_design.terminal import console
from probe_design.terminal.console import show_stages, show_steps, show_table, write_message
from probe_design.terminal.result_tables import build_result_table, list_plan_lines
from probe_design.terminal.whole_table import WholeTable
from solver import Result, plan
from solver.results.load_limits import LargestLoad, LoadLimits
from tests.support.paths import SCENE


@pytest.mark.parametrize("exact", [(0.035949, 0.00023751), (0.035951, 0.00023749)])
def test_a_load_that_is_printed_is_allowed(exact: tuple[float, float]) -> None:
    """To three digits the nearest number may lie above the limit, and would be refused."""
    limit = LargestLoad(*exact, "ratio")
    limits = LoadLimits(limit, None, None, limit)
    said = list_plan_lines(replace(plan(read_scene(SCENE)), load_limits=limits))[-1]
    assert "up to 0.0359 N, an indentation of 0.237 mm" in said
    stream = StringIO()
    Console(file=stream).print(WholeTable(build_result_table(Result("closed-form", 0.1, load_limits=limits))))
    assert " 0.0359 " in stream.getvalue()


def test_each_stage_has_one_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first one had two, of which one was never done."""
    stream = StringIO()
    monkeypatch.setattr(console, "find_terminal", lambda: Console(file=stream, force_terminal=True, width=80))
    with show_stages() as progress:
        for stage in ("first", "second"):
            for done in range(3):
                progress(stage, done, 2)
    frame = stream.getvalue().rpartition("\x1b[1A")[2]  # as it was drawn last
    assert frame.count("first") == frame.count("second") == 1
    assert frame.count("2/2") == 2


def figures() -> Table:
    headings = ("quantity", "value", "a heading of words")
    return Table(headings, [("far edges", "3.16227766e-05", "[/red]:smile: 1.2345e-308")], "a title of some words")


@pytest.mark.parametrize("width", ["1", "20", "40", "80", "0", "-1", "", "²", "wide", "1e3"])
def test_figures_are_whole_in_every_width(
    width: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", width)
    show_table(figures())
    text = capsys.readouterr().out
    for word in ("far edges", "3.16227766e-05", "[/red]:smile:", "1.2345e-308"):
        assert word in text
    assert "\u2026" not in text


def test_a_table_keeps_to_a_width_that_its_words_allow(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    show_table(figures())
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 60


def test_names_do_not_speak_to_the_terminal(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    name = "a\x1b[31m\x9b\x07\r\u202e\udcff[/b].toml"
    show_table(Table(("name",), [(name,)], name))
    write_message(f"wrote {name}")
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    with show_steps(name) as progress:
        progress(name)
    output, err = capsys.readouterr()
    assert output.count(r"a\x1b[31m\x9b") == 2
    assert err.count(r"a\x1b[31m\x9b") >= 3
    assert not any(code in output + err for code in ("\x1b[31m", "\x9b", "\x07", "\u202e", "\udcff"))
