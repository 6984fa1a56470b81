"""`probe-design tradeoff`: times and errors of every setting, against an independent code; its tables, its files."""

from __future__ import annotations

import html
import io
import json
import re
import signal
import time
from dataclasses import asdict
from pathlib import Path

import matplotlib.image
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from markdown_it import MarkdownIt
from rich.console import Console

from geometry import Scene
from geometry.common.errors import Refusal, printable
from probe_design.data.builtin import typical_scenes
from probe_design.tradeoffs.rows import Row, Setting, cheapest, distinct, judged, pareto
from probe_design.tradeoffs.study import FINEST, SETTINGS, SKIPPED, Tradeoff, tradeoff
from probe_design.tradeoffs.tables import SUMMARY, choice_table, literal, markdown, summary_cells, summary_table
from probe_design.tradeoffs.timing import with_other_tumours
from solver import evaluate
from solver.levels import BUILT
from tests.support.paths import REFERENCE, ROOT
from tests.support.program import begun, refused, run
from tests.support.references import named

SCENE = REFERENCE / "axisymmetric" / "shallow.toml"
ON_AXIS = ("shallow", "soft-cyst")
FEW = (Setting("closed-form", None), Setting("equivalent-inclusion", 0.03), Setting("axisymmetric", 0.01))
KEYS = set(asdict(Row("", "", None))) | {"held", "resolved", "pareto_stated", "pareto_true"}


@pytest.fixture(scope="module")
def found() -> Tradeoff:
    scenes = {name: named("axisymmetric", name).scene for name in ON_AXIS} | {"two": named("solid", "two-tumours-between").scene}
    return tradeoff(scenes, settings=FEW, finest=(Setting("axisymmetric", 1e-4), Setting("equivalent-inclusion", 0.01)))


def row(seconds: float | None, error: float | None, ratio: float | None = 1.0, evaluator: str = "axisymmetric") -> Row:
    return Row("scene", evaluator, 0.01, ratio, stated_error=error, seconds_probe=seconds)


def test_pareto_front_is_what_nothing_beats() -> None:
    fast, slow, fine, beaten, twin = row(1.0, 0.1), row(2.0, 0.2), row(3.0, 0.01), row(4.0, 0.01), row(3.0, 0.02)
    silent = row(None, None, None)
    assert pareto([beaten, fine, silent, slow, twin, fast]) == (fast, fine)
    assert pareto([silent]) == ()
    assert cheapest([fast, fine, slow], 0.05) is fine
    assert cheapest([fast, fine, slow], 0.1) is fast
    assert cheapest([fast, fine, slow], 0.001) is None


def test_the_same_answer_to_a_finer_question_counts_once() -> None:
    first, again, other = row(2.0, 0.1), row(1.0, 0.1), row(1.0, 0.1, 1.5)
    assert distinct([first, again, other, row(0.1, None, None)]) == (first, other)


def test_true_errors_are_known_up_to_the_reference_s_own() -> None:
    """Eq. TR.1: truth 1, reference 1.001 with 0.1 % stated; 1.03 is off by 2.9 % +- 0.1 %, 1.0015 by less than 0.15 %."""
    rows = judged([row(1.0, 0.05, 1.03, "closed-form"), row(2.0, 0.01, 1.0015), row(3.0, 1e-3, 1.001)], ["axisymmetric"])
    coarse, near, reference = rows
    assert reference.reference
    assert reference.true_error is None
    assert not coarse.same_level
    assert near.same_level
    assert coarse.resolved
    assert not near.resolved
    assert coarse.true_error_least <= 0.03 <= coarse.true_error_most
    assert near.true_error_most == pytest.approx(0.0015, rel=1e-3)
    assert all(one.held for one in rows)


def test_a_bound_that_does_not_hold_is_found() -> None:
    boastful = judged([row(1.0, 0.01, 1.03, "closed-form"), row(3.0, 1e-3, 1.0)], ["axisymmetric"])[0]
    assert not boastful.held
    without = judged([row(1.0, 0.01, 1.03, "closed-form")], ["axisymmetric"])[0]
    assert without.true_error is None
    assert without.held


@pytest.mark.slow
def test_true_errors_are_those_against_an_independent_code(found: Tradeoff) -> None:
    for name in ON_AXIS:
        truth = named("axisymmetric", name)
        (reference,) = (one for one in found.of(name) if one.reference)
        assert reference.ratio == pytest.approx(truth.ratio, rel=reference.stated_error + truth.uncertainty)
        for one in found.of(name):
            off = abs(one.ratio / truth.ratio - 1)
            assert one.true_error_least - truth.uncertainty <= off <= one.true_error_most + truth.uncertainty
            assert one.stated_error >= off - truth.uncertainty
    rough = next(one for one in found.of("shallow") if one.evaluator == "closed-form")
    assert rough.true_error > 0.003
    assert rough.log_sensitivity_error == pytest.approx(
        abs(rough.log_sensitivity / named("axisymmetric", "shallow").log_sensitivity - 1), abs=5e-4
    )


@pytest.mark.slow
def test_stated_errors_hold_and_answers_are_the_evaluators_own(found: Tradeoff) -> None:
    assert found.broken == ()
    assert len(found.rows) == 3 * (len(FEW) + 2)  # an answer to 1e-4 is not fine enough to do without the second of the finest
    for one in found.of("shallow"):
        told = evaluate(found.scenes["shallow"], one.evaluator, one.accuracy or 0.01)
        assert (one.ratio, one.log_sensitivity, one.stated_error) == (told.ratio, told.log_sensitivity, told.error_estimate)


@pytest.mark.slow
def test_a_refusal_is_a_row_with_its_reason(found: Tradeoff) -> None:
    silent = [one for one in found.of("two") if one.evaluator == "axisymmetric"]
    assert len(silent) == 2
    for one in silent:
        assert (one.ratio, one.seconds_probe, one.true_error) == (None, None, None)
        assert one.reason is not None
        assert "equivalent-inclusion" in one.reason
    (reference,) = (one for one in found.of("two") if one.reference)
    assert (reference.evaluator, reference.accuracy) == ("equivalent-inclusion", 0.01)


@pytest.mark.slow
def test_times_are_there_where_there_is_an_answer(found: Tradeoff) -> None:
    finest = {(one.evaluator, one.accuracy) for one in found.rows} - {(one.evaluator, one.accuracy) for one in FEW}
    for one in (one for one in found.rows if one.ratio is not None):
        assert one.seconds_first > 0
        assert one.seconds_probe > 0
        assert (one.seconds_tumour is None) == ((one.evaluator, one.accuracy) in finest)
    bare = tradeoff({"bare": named("axisymmetric", "homogeneous").scene}, settings=FEW[:1], finest=FEW[2:])
    assert [one.seconds_tumour for one in bare.rows] == [None, None]


@pytest.mark.slow
def test_a_reference_that_left_the_groove_out_says_so() -> None:
    """The 3D reference is 1.9 % from what rotationally symmetric levels answer; they state 8 %."""
    groove = named("solid", "groove-on-axis")
    told = tradeoff({"groove": groove.scene}, settings=FEW[1:], finest=())
    assert [one.scene for one in told.uncertain] == ["groove"]
    for one in told.rows:
        off = abs(one.ratio / groove.ratio - 1)
        assert off > 0.01
        assert off <= one.true_error_most
        assert not one.resolved


@pytest.mark.slow
def test_tables_fit_a_terminal(found: Tradeoff) -> None:
    console = Console(width=80, file=io.StringIO(), record=True)
    console.print(summary_table(found))
    console.print(choice_table(found))
    text = console.export_text()
    assert "equivalent-inclusion" in text
    assert "\u2026" not in text
    assert all(name in text for name in found.scenes)


@example("<script>alert(1)</script>")
@example("[here](javascript:alert) &amp; _so_ **on** ![x](y) <a@b.c> | # 1 `x`")
@example("\x1b[31mred\x07")
@given(st.one_of(st.text(st.sampled_from("ab1 <>&[]()!*_`\\#+-.|~$:/\x1b\n"), min_size=1), st.text(min_size=1)))
def test_names_in_markdown_are_shown_as_they_are(name: str) -> None:
    """As another implementation of CommonMark renders the page."""
    line = " ".join(name.split())
    page = MarkdownIt("commonmark", {"html": True}).render(f"- {literal(f'{line}, end')}")
    assert html.unescape(page) == f"<ul>\n<li>{printable(line)}, end</li>\n</ul>\n"


def test_every_level_is_asked_or_said_to_be_skipped() -> None:
    assert {one.evaluator for one in (*SETTINGS, *FINEST)} | set(SKIPPED) == set(BUILT)


@pytest.mark.parametrize("name", ["shallow", "soft-cyst"])
def test_other_tumours_lie_inside_the_old_ones(name: str) -> None:
    scene = named("axisymmetric", name).scene
    body, other = scene.inclusion[0], with_other_tumours(scene).inclusion[0]
    assert abs(other.depth - body.depth) + other.diameter / 2 < body.diameter / 2
    Scene.model_validate(with_other_tumours(scene).model_dump())


def test_built_in_scenes_are_whole_scenes() -> None:
    scenes = typical_scenes()
    assert len(scenes) == 5
    for scene in scenes.values():
        assert Scene.model_validate(scene.model_dump()) == scene
    assert scenes["soft"].inclusion[0].youngs_modulus < scenes["soft"].tissue.youngs_modulus
    assert scenes["off-axis"].inclusion[0].x > 0


def test_what_nobody_takes_is_refused() -> None:
    scene = named("axisymmetric", "shallow").scene
    sliding = scene.model_copy(update={"contact": scene.contact.model_copy(update={"interface": "unilateral"})})
    with pytest.raises(Refusal, match="unilateral"):
        tradeoff({"sliding": sliding}, settings=FEW, finest=())


def test_files_and_one_json_object(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("probe_design.tradeoffs.timing.REPEATS", 1)
    ended = run("tradeoff", SCENE, "-o", tmp_path / "out", "--json")
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout)
    assert set(told) == {"scenes", "rows", "cheapest", "skipped", "warnings", "files", "provenance"}
    assert told["warnings"] == []
    assert [Path(file).name for file in told["files"]] == ["tradeoff.png", "tradeoff.md", "tradeoff.json"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["tradeoff.json", "tradeoff.md", "tradeoff.png"]
    assert json.loads(Path(told["files"][2]).read_text()) == told
    assert all(set(one) == KEYS for one in told["rows"])
    assert [(one["evaluator"], one["accuracy"]) for one in told["rows"]][: len(SETTINGS)] == [
        (one.evaluator, one.accuracy) for one in SETTINGS
    ]
    assert len(told["rows"]) == len(SETTINGS) + 1  # the first of the finest is fine enough
    assert all(one["held"] for one in told["rows"])
    assert told["rows"][-1]["reference"]
    assert {one["tolerance"] for one in told["cheapest"]} == {0.05, 0.01, 0.001}
    picture = matplotlib.image.imread(told["files"][0])
    assert picture.std() > 0.05
    page = Path(told["files"][1]).read_text()
    assert "| " + " | ".join(SUMMARY) + " |" in page
    assert "published: " in page
    assert "warning" not in ended.stderr


def test_bad_input_is_one_line(tmp_path: Path) -> None:
    assert "absent.toml" in refused("tradeoff", "absent.toml", "-o", tmp_path)
    assert "--output" in refused("tradeoff", SCENE)
    (tmp_path / "file").write_text("in the way")
    assert "file" in refused("tradeoff", SCENE, "-o", tmp_path / "file")


@pytest.mark.slow
def test_interrupted_is_one_line_and_leaves_no_file(tmp_path: Path) -> None:
    with begun("probe_design.tradeoffs.study", "tradeoff", "-o", tmp_path) as started:
        time.sleep(3)
        started.send_signal(signal.SIGINT)
        out, said = started.communicate(timeout=60)
    assert started.returncode == 130
    assert out == ""
    assert said.splitlines()[-1] == "probe-design: interrupted; nothing half-written is left"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_readme_s_table_is_one_of_the_command_s(found: Tradeoff) -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    block = re.search(r"<!-- tradeoff -->\n(.*?)\n<!-- /tradeoff -->", readme, re.S)
    assert block is not None
    lines = block[1].splitlines()
    assert lines[:2] == markdown(SUMMARY, []).splitlines()
    shown = [tuple(cell.strip() for cell in line.strip("|").split("|")) for line in lines[2:]]
    told = [(one.evaluator, "-" if one.accuracy is None else f"{one.accuracy:g}") for one in SETTINGS]
    assert [one for one in told if one not in {line[:2] for line in shown}] == []
    figure = re.compile(r"<?\d\.\de-?\+?\d\d\*?|\d[\d.e+-]*|reference|-")
    for line in (*shown, *summary_cells(found)):
        assert len(line) == len(SUMMARY)
        assert re.fullmatch(r"\d+/\d+", line[2])
        assert all(figure.fullmatch(cell) for cell in line[3:]), line
