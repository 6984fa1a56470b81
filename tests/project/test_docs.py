"""Every command of the pages in docs runs and prints what its page shows, page by page from top to bottom in one folder."""

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

from tests.support.page_output import Line, find_missing, is_alike, read_lines
from tests.support.paths import DOCS, ROOT
from tests.support.slow import slow_unless

PAGES = {str(path.relative_to(DOCS)): path.read_text(encoding="utf-8") for path in sorted(DOCS.rglob("*.md"))}
# pages that show shortened tables, placeholders for files, or checks that fail by intention: only their other commands run
SHORTENED_NAMES = (
    "design-search",
    "explore",
    "films",
    "hardware",
    "lab",
    "locate",
    "materials",
    "next-reading",
    "survey",
    "sweep",
    "tolerances",
)
SHORTENED = {f"guides/{name}.md" for name in SHORTENED_NAMES}
SERVER = "probe-design explore"  # serves until Ctrl-C: tests of the explorer start it


def list_commands(name: str) -> list[Line]:
    page = re.sub(r"```console\n.*?```", "", PAGES[name], flags=re.S) if name in SHORTENED else PAGES[name]
    return [line for line in read_lines(page) if not line.command.startswith(SERVER)]


COMMANDS = {name: lines for name in PAGES if (lines := list_commands(name))}
QUICK = ("explanation/physics.md",)


@pytest.mark.timeout(1200)  # a page may be a whole session
@pytest.mark.parametrize("page", slow_unless(QUICK.__contains__, COMMANDS))
def test_commands_of_a_page_run(page: str, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    for line in COMMANDS[page]:
        printed = run_line(line.command, tmp_path)
        assert find_missing(line, printed) is None, (line.command, find_missing(line, printed), printed)


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


def test_alike_lines_differ_in_digits_alone() -> None:
    assert is_alike("│ ratio │ 0.5629 │", "│ ratio   │  0.563 │")
    assert is_alike("axisymmetric, 3.2 s", "axisymmetric, 12 s")
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
