"""What docstrings, comments and pages name is there: files, modules and programs.

A name with a slash counts from the repository's root, a link from its page. The bare name of a source stands for one in the
folder of the module that names it; in a page, in the folder of the last path before it in the same line or table cell.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.named import OURS, commands, exists, files, modules, resolves, runs, texts
from tests.support.paths import REFERENCE, ROOT

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), REFERENCE / "README.md"]
SOURCES = [path for folder in (*OURS, "examples") for path in sorted((ROOT / folder).rglob("*.py"))]
GENERATED = {"out"}  # folders that commands write


def there(name: str, folder: Path | None) -> bool:
    if "/" in name:
        return name.split("/")[0] in GENERATED or exists(name)
    return folder is not None and exists(name, folder)


def test_sources_name_files_that_exist() -> None:
    wrong = []
    for path in SOURCES:
        for text in texts(path):
            wrong += [f"{path.relative_to(ROOT)}: {name}" for name in files(text) if not there(name, path.parent)]
    assert wrong == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_name_files_that_exist(page: Path) -> None:
    wrong = []
    for cell in (cell for line in prose(page).splitlines() for cell in line.split("|")):
        folder = None
        for name in files(cell):
            wrong += [] if there(name, folder) else [name]
            folder = (ROOT / name).parent if "/" in name else folder
    assert wrong == []


def prose(page: Path) -> str:
    """A page without blocks of code, whose files are the reader's, and without links' targets, which have a test of their own."""
    return re.sub(r"(?s)```.*?```|\]\([^)]*\)", "", page.read_text(encoding="utf-8"))


def test_sources_name_modules_that_exist() -> None:
    wrong = []
    for path in SOURCES:
        wrong += [f"{path.relative_to(ROOT)}: {name}" for text in texts(path) for name in modules(text) if not resolves(name)]
        wrong += [f"{path.relative_to(ROOT)}: -m {name}" for text in texts(path) for name in commands(text) if not runs(name)]
    assert wrong == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_name_modules_that_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert [name for name in modules(text) if not resolves(name)] == []
    assert [name for name in commands(text) if not runs(name)] == []
