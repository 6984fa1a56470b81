"""Every command and snippet of README runs; its two install commands are the ones that CI runs.

Most take seconds; `tests/probe_design/commands/test_main.py` starts every command on something cheap.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.support.page_output import find_missing, read_lines
from tests.support.paths import ROOT
from tests.support.slow import slow_unless

README = (ROOT / "README.md").read_text(encoding="utf-8")
PATHS = {str(path.relative_to(ROOT)): path for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))}
PAGES = {name: path.read_text(encoding="utf-8") for name, path in PATHS.items()}
INSTALL = "python3 -m venv .venv && .venv/bin/pip install -c constraints.txt -e . && .venv/bin/probe-design optimize -o out"
TEST = "python3 -m venv .venv && .venv/bin/pip install -c constraints.txt -e '.[test]' && .venv/bin/pytest"


def blocks(language: str, page: str = README) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page, re.S)


LINES = [line.removeprefix("$ ") for block in blocks("bash") + blocks("console") for line in block.splitlines()]
COMMANDS = [line for line in LINES if line.startswith("probe-design ")]
BUILTIN = "probe-design optimize -o out"  # has a test of its own


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("readme")
    shutil.copytree(ROOT / "examples", place / "examples")
    return place


def test_install_commands_are_ci_s() -> None:
    assert INSTALL in LINES
    assert TEST in LINES
    assert TEST in (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()


def test_ci_runs_every_test() -> None:
    """README's command leaves out what is marked slow, and CI runs that, and what README says runs all."""
    options = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["pytest"]["ini_options"]["addopts"]
    assert options.endswith("-m 'not slow'")
    assert ".venv/bin/pytest -m slow" in (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()
    assert "`.venv/bin/pytest -m ''`" in README


def test_there_are_commands() -> None:
    assert len(COMMANDS) >= 5


def cheap(command: str) -> bool:
    return "closed-form" in command or command.startswith("probe-design plan")


@pytest.mark.parametrize("command", slow_unless(cheap, [command for command in COMMANDS if command != BUILTIN]))
def test_command_runs(command: str, folder: Path) -> None:
    words = shlex.split(command)
    before = [line for line in COMMANDS[: COMMANDS.index(command)] if any(f" -o {word}" in line for word in words[1:])]
    for line in before:  # makes the files that this command reads: its own test may run in another process
        if not (folder / shlex.split(line)[-1]).exists():
            run_line(line, folder)
    ended = run_line(command, folder)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout or "wrote" in ended.stderr
    shown = next(line for line in read_lines(README) if line.command == command)
    assert find_missing(shown, ended.stdout) is None, (find_missing(shown, ended.stdout), ended.stdout)


def run_line(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-m", "probe_design", *shlex.split(line)[1:]]
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, stdin=subprocess.DEVNULL, timeout=250)


@pytest.mark.slow
def test_printed_optimum_is_what_the_command_prints(folder: Path) -> None:
    assert BUILTIN in COMMANDS
    kept = os.environ.get("README_OPTIMUM")  # what README's first command has printed in .ci/run; its files are in out
    printed = Path(kept).read_text(encoding="utf-8") if kept else run_line(BUILTIN, folder).stdout
    shown = next(block for block in blocks("console") if BUILTIN in block)
    for row in ("detected of 100, ratio alone", "detected of 100, both", "force, N", "outer radius, mm"):
        computed, stated = (numbers(text, row) for text in (printed, shown))
        assert len(computed) == len(stated) >= 2  # start and recommended at least
        assert computed == pytest.approx(stated, rel=0.02)  # IPOPT may stop elsewhere on another machine
    build, detect, *_ = (line for line in printed.splitlines()[-6:] if not line.startswith(("│", "└", "Verified")))
    assert build.startswith("Build this: inner radius ")  # it ends with a verdict
    assert detect.startswith("Of 100 of your tumours it detects ")
    ended = run_line("probe-design evaluate out/design.toml", ROOT if kept else folder)  # the command that the first one names
    assert ended.returncode == 0, ended.stderr
    assert "charge_ratio_error" in ended.stdout
    assert "reading.accuracy" in ended.stderr


def numbers(table: str, row: str) -> list[float]:
    line = next(line for line in table.splitlines() if row in line)
    return [float(cell) for cell in re.findall(r"[│|]\s+([0-9.e+-]+)(?: ± [0-9.e+-]+)?\s+(?=[│|])", line)]


@pytest.mark.parametrize(
    "snippet", slow_unless(README.__contains__, [x for page in PAGES.values() for x in blocks("python", page)])
)
def test_snippet_runs(snippet: str, folder: Path) -> None:
    if "run.probe" in snippet and not (folder / "run.probe").exists():  # recorded by a command of the page
        assert run_line("probe-design read examples/scene.toml --virtual --record run.probe", folder).returncode == 0
    ended = subprocess.run([sys.executable, "-W", "error", "-c", snippet], cwd=folder, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.strip()


def test_readme_is_short() -> None:
    assert len(README.splitlines()) <= 150


def test_scene_in_the_tutorial_is_the_example() -> None:
    assert blocks("toml", PAGES["docs/start/tutorial.md"])[0] == (ROOT / "examples" / "scene.toml").read_text(encoding="utf-8")


def test_relative_links_exist() -> None:
    for name, page in PAGES.items():
        folder = PATHS[name].parent
        for target in re.findall(r"\]\(([^)]+)\)", re.sub(r"`[^`\n]*`", "", page)):  # formulas have brackets too
            path, _, heading = target.partition("#")
            assert target.startswith("https://") or (folder / path).exists(), (name, target)
            if heading and path.endswith(".md"):
                headings = re.findall(r"^#+ (.+)$", (folder / path).read_text(encoding="utf-8"), re.M)
                assert heading in {title.lower().replace(" ", "-") for title in headings}, (name, target)
