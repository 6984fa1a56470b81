"""Every command of the pages in docs runs, page by page from top to bottom in one folder; the project's own pages are whole."""

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

from tests.support.paths import DOCS, ROOT
from tests.support.slow import slow_unless

COMMANDS = {
    path.name: [
        line for block in re.findall(r"```bash\n(.*?)```", path.read_text(encoding="utf-8"), re.S) for line in block.splitlines()
    ]
    for path in sorted(DOCS.rglob("*.md"))
}
QUICK = ("physics.md",)


@pytest.mark.timeout(1200)  # a page may be a whole session
@pytest.mark.parametrize("page", slow_unless(QUICK.__contains__, [name for name, lines in COMMANDS.items() if lines]))
def test_commands_of_a_page_run(page: str, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), os.environ.get("PYTHONPATH", "")))}
    for line in COMMANDS[page]:
        program, *words = shlex.split(line)
        output = tmp_path / words.pop() if ">" in words else tmp_path / "printed.txt"
        words = [word for word in words if word != ">"]
        start = {"probe-design": ["-m", "probe_design"], "python": []}[program]
        with output.open("w") as printed:
            command = [sys.executable, *start, *words]
            ended = subprocess.run(
                command, cwd=tmp_path, stdout=printed, stderr=subprocess.PIPE, text=True, env=environment, timeout=280
            )
        assert ended.returncode == 0, (line, ended.stderr)


def test_there_are_commands() -> None:
    assert {"choosing-accuracy.md", "paper.md", "physics.md", "worked-design.md"} <= {
        name for name, lines in COMMANDS.items() if lines
    }


def test_citation_is_of_this_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = dict(re.findall(r"^([\w-]+): (.+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.M))
    assert (citation["title"], citation["version"], citation["license"]) == (
        project["name"],
        project["version"],
        project["license"],
    )
    assert f"## {project['version']}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
