"""Every command of the pages in docs runs and prints what its page shows, page by page from top to bottom in one folder."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

import pytest

from tests.support.paths import DOCS, ROOT
from tests.support.slow import slow_unless


@dataclass(frozen=True)
class Line:
    """A command of a page, and the lines of its output that the page shows, in their order."""

    command: str
    shown: tuple[str, ...] = ()


def read_lines(page: str) -> list[Line]:
    lines: list[Line] = []
    for language, block in re.findall(r"```(bash|console)\n(.*?)```", page, re.S):
        if language == "bash":
            lines += map(Line, block.splitlines())
        else:
            commands = re.findall(r"^\$ (.+)\n((?:(?!\$ ).*\n)*)", block, re.M)
            lines += [Line(command, tuple(filter(str.strip, shown.splitlines()))) for command, shown in commands]
    return lines


PAGES = {str(path.relative_to(DOCS)): path.read_text(encoding="utf-8") for path in sorted(DOCS.rglob("*.md"))}
COMMANDS = {name: lines for name, page in PAGES.items() if (lines := read_lines(page))}
QUICK = ("explanation/physics.md",)
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
NOT_REPRODUCED = re.compile(r"\d+(\.\d+)? s\b|.*(chi-square|residual)")  # times and what is zero but for rounding


@pytest.mark.timeout(1200)  # a page may be a whole session
@pytest.mark.parametrize("page", slow_unless(QUICK.__contains__, COMMANDS))
def test_commands_of_a_page_run(page: str, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    for line in COMMANDS[page]:
        printed = run_line(line.command, tmp_path)
        if line.shown:
            waiting = iter(printed.splitlines())
            for shown in line.shown:
                assert any(is_alike(shown, row) for row in waiting), (line.command, shown, printed)


def run_line(line: str, folder: Path) -> str:
    """Run a command of a page and return what it prints."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), os.environ.get("PYTHONPATH", "")))}
    words = shlex.split(line)
    program, *words = words[:-2] if ">" in words else words
    if program == "cat":
        return (folder / words[0]).read_text(encoding="utf-8")
    start = {"probe-design": ["-m", "probe_design"], "python": []}[program]
    command = [sys.executable, *start, *words]
    ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment, timeout=280)
    assert ended.returncode == 0, (line, ended.stderr)
    if ">" in line:
        (folder / shlex.split(line)[-1]).write_text(ended.stdout, encoding="utf-8")
    return ended.stdout


def is_alike(shown: str, printed: str) -> bool:
    """Return whether two lines have the same words, and numbers that differ by at most 5 %, or 0.02 where they are small."""
    if not all(x == y for x, y in zip_longest(*(NUMBER.sub("#", line).split() for line in (shown, printed)))):
        return False
    if NOT_REPRODUCED.match(shown):
        return True
    numbers = [[float(text) for text in NUMBER.findall(line)] for line in (shown, printed)]
    return numbers[1] == pytest.approx(numbers[0], rel=0.05, abs=0.02)


def test_alike_lines_differ_in_digits_alone() -> None:
    assert is_alike("│ ratio │ 0.5629 │", "│ ratio   │  0.563 │")
    assert not is_alike("│ ratio │ 0.56 │", "│ ratio │ 0.76 │")
    assert not is_alike("│ ratio │ 0.56 │", "│ stress │ 0.56 │")


def test_there_are_commands() -> None:
    assert {
        "guides/choosing-accuracy.md",
        "explanation/paper.md",
        "explanation/physics.md",
        "start/tutorial.md",
    } <= COMMANDS.keys()


def test_citation_is_of_this_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = dict(re.findall(r"^([\w-]+): (.+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.M))
    assert (citation["title"], citation["version"], citation["license"]) == (
        project["name"],
        project["version"],
        project["license"],
    )
    assert f"## {project['version']}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
