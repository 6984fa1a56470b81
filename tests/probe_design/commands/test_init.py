"""`init` writes files that the program reads and another library parses; `--install-completion` writes what shells load."""

from __future__ import annotations

import os
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


def test_answers_typed_at_a_terminal_are_asked_for_again_until_they_have_a_unit(tmp_path: Path) -> None:
    keyboard, terminal = pty.openpty()
    os.write(keyboard, b"design\n5\n6 kPa\n\n0 mm\n" + b"\n" * 7 + b"0.2 N\n")
    words = [sys.executable, "-m", "probe_design", "init", "-o", "mine.toml"]
    ended = subprocess.run(words, stdin=terminal, capture_output=True, text=True, cwd=tmp_path, timeout=60)
    os.close(terminal)
    assert (ended.returncode, ended.stdout) == (0, "wrote mine.toml; next: probe-design optimize -o out mine.toml\n"), (
        ended.stderr
    )
    assert "Error: a modulus with its unit" in ended.stderr
    design = read_design(tmp_path / "mine.toml")
    assert (design.scene.tissue.youngs_modulus, design.scene.tissue.layer) == (pytest.approx(6e3), ())
    assert design.limits.force == pytest.approx(0.2)
    assert design.population.depth.values == pytest.approx((0.010, 0.025))


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
