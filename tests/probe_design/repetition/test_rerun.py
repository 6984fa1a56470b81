"""`rerun`: what it repeats, what it notices, and what it refuses in one line."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from geometry import read_scene
from geometry.provenance.block import build_provenance
from probe_design import evaluate
from probe_design.commands.main import cli
from probe_design.repetition.command_line import build_rerun_words
from tests.support.paths import EXAMPLES, ROOT, SCENE
from tests.support.program import Ended, refused, run

QUESTION = ("evaluate", "scene.toml", "--evaluator", "closed-form", "--json")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """With a scene and a result; programs that are started there are this tree's."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(ROOT), os.environ.get("PYTHONPATH", ""))))
    (tmp_path / "scene.toml").write_bytes(SCENE.read_bytes())
    (tmp_path / "made.json").write_text(run(*QUESTION, cwd=tmp_path).stdout)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def rerun(*words: str | Path) -> Ended:
    return run("rerun", *words)


def test_an_answer_is_repeated(folder: Path) -> None:
    ended = rerun("made.json")
    assert ended.returncode == 0, ended.stderr
    assert "all agree" in ended.stdout
    output = json.loads(rerun("made.json", "--json").stdout)
    assert output["agrees"] is True
    assert output["command"] == list(QUESTION)


@pytest.mark.parametrize(
    "words",
    [
        pytest.param(  # whose further arguments are none
            ("estimate", "scene.toml", "--ratio", "0.563", "--accuracy", "0.05", "--json"), marks=pytest.mark.slow
        ),
        ("tissue", "show", "breast", "--json"),
    ],
)
def test_answers_of_other_verbs_are_repeated(words: tuple[str, ...], folder: Path) -> None:
    (folder / "other.json").write_text(run(*words, cwd=folder).stdout)
    assert "all agree" in rerun("other.json").stdout


def test_another_number_is_noticed(folder: Path) -> None:
    record_table = json.loads((folder / "made.json").read_text())
    record_table["stress_inner"] *= 1.2
    (folder / "made.json").write_text(json.dumps(record_table))
    ended = rerun("made.json")
    assert ended.returncode == 1
    assert "stress_inner: " in ended.stdout


def test_an_answer_beside_its_scene_is_repeated_from_elsewhere(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    assert run("rerun", folder / "made.json", cwd=tmp_path_factory.mktemp("elsewhere")).returncode == 0


def test_a_scene_that_changed_or_is_gone_is_refused(folder: Path) -> None:
    scene = folder / "scene.toml"
    scene.write_text(scene.read_text().replace("0.1 mm", "0.2 mm"))
    assert "another content" in refused("rerun", "made.json")
    scene.unlink()
    assert "missing" in refused("rerun", "made.json")


def test_what_tells_nothing_of_its_origin_is_refused(folder: Path) -> None:
    (folder / "empty.json").write_text("{}")
    for name in ("empty.json", "scene.toml"):
        assert "block of provenance" in refused("rerun", name)
    for name in ("nothing.json", "."):
        assert "that can be read" in refused("rerun", name)


@pytest.mark.parametrize("text", ["ISO-10303-21;\nHEADER;\n", "  0\nSECTION\n", "%PDF-1.4\n%\u00ac", "\x89PNG\r\n", "part\n"])
def test_of_a_drawing_the_folder_is_asked_for(text: str, folder: Path) -> None:
    (folder / "drawing").write_text(text, encoding="latin-1")
    assert "of a drawing or solid its folder" in refused("rerun", "drawing")


def test_what_python_made_is_refused(folder: Path) -> None:
    (folder / "python.json").write_text(json.dumps(evaluate("scene.toml", evaluator="closed-form", accuracy=0.1).as_dict()))
    assert "Python program" in refused("rerun", "python.json")


@pytest.mark.parametrize(
    "words", [["nonsense"], ["evaluate", "scene.toml", "--colour", "red"], ["tissue"], ["read", "--device", "usb"]]
)
def test_a_command_that_cannot_be_repeated_is_refused(words: list[str], folder: Path) -> None:
    block = build_provenance(read_scene(SCENE)) | {"command": words}
    (folder / "odd.json").write_text(json.dumps({"ratio": 1.0, "provenance": block}))
    assert "file = " in refused("rerun", "odd.json")


@pytest.mark.parametrize(
    "damage",
    [
        {"inputs": ["a"]},
        {"inputs": {"a": 1}},
        {"dependencies": "numpy"},
        {"command": {"a": 1}},
        {"command": ["tissue", ["list"]]},
    ],
)
def test_a_damaged_block_is_refused(damage: dict[str, Any], folder: Path) -> None:
    block = json.loads((folder / "made.json").read_text())["provenance"] | damage
    (folder / "odd.json").write_text(json.dumps({"ratio": 1.0, "provenance": block}))
    assert "allowed: a block of provenance as it was written" in refused("rerun", "odd.json")


def test_a_file_that_says_that_rerun_made_it_would_have_no_end(folder: Path) -> None:
    block = build_provenance(read_scene(SCENE)) | {"command": ["rerun", "odd.json"], "inputs": {}}
    (folder / "odd.json").write_text(json.dumps({"ratio": 1.0, "provenance": block}))
    assert "file = made by 'rerun'" in refused("rerun", "odd.json")


def test_no_file_beside_is_written_and_no_cluster_asked(tmp_path: Path) -> None:
    words = ["check", "--virtual", "--report", "page.html"]
    assert build_rerun_words(cli, words, {}, tmp_path, tmp_path) == ["check", "--virtual", "--json", "--"]
    words = ["sweep", "sweep.toml", "--scheduler", "tcp://host:8786", "-o", "out"]
    assert build_rerun_words(cli, words, {}, tmp_path, tmp_path) == [
        "sweep",
        "--output",
        str(tmp_path),
        "--json",
        "--",
        "sweep.toml",
    ]


@pytest.mark.parametrize("content", [b"ratio\n\xff\n", b'ratio\n"' + 200_000 * b"9"])
def test_a_damaged_table_is_refused(content: bytes, folder: Path) -> None:
    (folder / "parts.json").write_bytes((folder / "made.json").read_bytes())
    (folder / "results.csv").write_bytes(content)
    assert "results.csv': allowed: a table as it was written" in refused("rerun", str(folder))


def test_cells_without_a_heading_are_passed_over(folder: Path) -> None:
    (folder / "parts.json").write_bytes((folder / "made.json").read_bytes())
    (folder / "results.csv").write_text("ratio\n0.5,0.6\n")
    assert "rows: " in rerun(".").stdout


@pytest.mark.slow
def test_a_sweep_s_folder_is_repeated(folder: Path) -> None:
    (folder / "sweep.toml").write_bytes((EXAMPLES / "sweep.toml").read_bytes())
    assert run("sweep", "sweep.toml", "-o", "out", "--workers", "1").returncode == 0
    assert rerun("out").returncode == 0
    table = folder / "out" / "results.csv"
    table.write_text(table.read_text().replace(",ok,", ",failed,", 1))
    assert rerun("out").returncode == 1


@pytest.mark.slow
def test_an_export_s_record_is_repeated(folder: Path) -> None:
    assert run("export", "scene.toml", "-o", "out").returncode == 0
    table = folder / "out" / "tolerances.csv"
    kept = table.read_text()
    table.write_text(kept.replace("hole_diameter,diameter,outer,8.2,", "hole_diameter,diameter,outer,8.3,"))
    assert table.read_text() != kept
    first, last = rerun("out").stdout.splitlines()  # the tables' numbers too, and all others agree
    assert first.startswith("tolerances[2].nominal: 8.3 then, 8.2 now")
    assert int(last.split()[0]) > 40
    record = folder / "out" / "parts.json"
    entry = json.loads(record.read_text())
    record.write_text(json.dumps(entry | {"design": "0" * 64}))
    assert rerun(record).returncode == 1
