"""`init` writes files that the program reads and another library parses; `--install-completion` writes what shells load."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from geometry.scenes.scene import Scene
from probe_design.populations.design_file import read_design
from solver.evaluation import evaluate
from tests.support.program import refused, started

pty = pytest.importorskip("pty")  # Windows has no such terminals


def test_a_first_scene_states_the_answers_and_can_be_evaluated(tmp_path: Path) -> None:
    path = tmp_path / "first.toml"
    assert started("init", "-o", path).stdout == f"wrote {path}; next: probe-design evaluate {path}\n"
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    assert (tables["tissue"]["youngs_modulus"], tables["tissue"]["layer"][0]["thickness"]) == ("8 kPa", "2 mm")
    result = evaluate(Scene.from_file(path), evaluator="closed-form")
    assert 0 < result.ratio < 10
    assert "a file that does not exist yet, or --force" in refused("init", "-o", path)


def typed(keys: bytes, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run `init -o mine.toml` at a terminal on which ``keys`` are typed."""
    keyboard, terminal = pty.openpty()
    os.write(keyboard, keys)
    words = [sys.executable, "-m", "probe_design", "init", "-o", "mine.toml"]
    ended = subprocess.run(words, stdin=terminal, capture_output=True, text=True, cwd=folder, timeout=60)
    os.close(terminal)
    return ended


def test_answers_typed_at_a_terminal_are_asked_for_again_until_they_have_a_unit(tmp_path: Path) -> None:
    ended = typed(b"design\n5\n6 kPa\n\n0 mm\n" + b"\n" * 7 + b"0.2 N\n", tmp_path)
    assert (ended.returncode, ended.stdout) == (0, "wrote mine.toml; next: probe-design optimize -o out mine.toml\n"), (
        ended.stderr
    )
    assert re.search(r"Error: a modulus with its unit.*\(the unit is missing\)", ended.stderr)
    design = read_design(tmp_path / "mine.toml")
    assert (design.scene.tissue.youngs_modulus, design.scene.tissue.layer) == (pytest.approx(6e3), ())
    assert design.limits.force == pytest.approx(0.2)
    assert design.population.depth.values == pytest.approx((0.010, 0.025))


def test_answers_that_contradict_each_other_are_asked_for_again(tmp_path: Path) -> None:
    """A sphere of 30 mm at 8 mm leaves the tissue: all answers were lost. Enter keeps them, and the depth is typed anew."""
    ended = typed(b"scene\n\n50 mm\n\n\n30 mm\n8 mm\n\n\n\n" + b"\n" * 5 + b"25 mm\n\n\n\n", tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert "inclusion[0].depth = 8 mm: allowed: above 15 mm" in ended.stderr
    tables = tomllib.loads((tmp_path / "mine.toml").read_text(encoding="utf-8"))
    assert (tables["tissue"]["depth"], tables["inclusion"][0]["diameter"]) == ("50 mm", "30 mm")
    assert tables["inclusion"][0]["depth"] == "25 mm"


def test_a_file_that_cannot_be_written_is_refused_before_any_question(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("mine", encoding="utf-8")
    ended = typed(b"scene\n", tmp_path)
    assert (ended.returncode, ended.stderr.count("\n")) == (2, 1)
    assert (tmp_path / "mine.toml").read_text(encoding="utf-8") == "mine"
    assert "a file in a folder that exists" in refused("init", "-o", tmp_path / "nowhere" / "mine.toml")


@pytest.mark.parametrize(("shell", "place"), [("bash", "data/bash-completion/completions/probe-design"), ("zsh", "z/.zshrc")])
def test_a_completion_is_installed_once(shell: str, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "z").mkdir()
    for key, name in (("XDG_DATA_HOME", "data"), ("ZDOTDIR", "z")):
        monkeypatch.setenv(key, str(tmp_path / name))
    for _ in range(2):
        assert started("--install-completion", shell).returncode == 0
    text = (tmp_path / place).read_text(encoding="utf-8")
    assert text.count("_PROBE_DESIGN_COMPLETE=") == 1


def test_an_unknown_shell_is_refused_with_those_that_are_known() -> None:
    assert "install-completion = 'tcsh': allowed: one of bash, fish, zsh" in refused("--install-completion", "tcsh")
