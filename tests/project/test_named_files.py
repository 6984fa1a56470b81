"""What docstrings, comments and pages name is there: files, modules and programs.

A name with a slash counts from the repository's root, a link from its page. The bare name of a source stands for one in the
folder of the module that names it; in a page, in the folder of the last path before it in the same line or table cell, or else in
the folder that the section's heading names.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.imports import OURS, everywhere, module, sources
from tests.support.named import commands, exists, files, modules, paths, resolves, runs, texts
from tests.support.paths import REFERENCE, ROOT

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), REFERENCE / "README.md"]
SOURCES = [path for folder in (*OURS, "examples") for path in sources(folder)]
GENERATED = {"out"}  # folders that commands write


def path_exists(path: Path) -> bool:
    return path.parts[0] in GENERATED or exists(path)


def test_sources_name_files_that_exist() -> None:
    wrong = []
    for source in SOURCES:
        own_path = source.relative_to(ROOT)
        named = [Path(name) if "/" in name else own_path.parent / name for text in texts(source) for name in files(text)]
        wrong += [f"{own_path}: {path}" for path in named if not path_exists(path)]
    assert wrong == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_name_files_that_exist(page: Path) -> None:
    assert [str(path) for path in paths(page.read_text(encoding="utf-8")) if not path_exists(path)] == []


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


def test_every_benchmark_has_a_purpose() -> None:
    """It is named by a page, or imported by one that is."""
    programs = {module(path): path for path in sources("benchmarks") if path.name != "__init__.py"}
    pages = [page.read_text(encoding="utf-8") for page in PAGES]
    named = {module(ROOT / path) for page in pages for path in paths(page) if path.suffix == ".py"}
    named |= {name for page in pages for name in commands(page)}
    waiting = [name for name in programs if name.removesuffix(".__main__") in named]
    reached: set[str] = set()
    while waiting:
        reached.add(name := waiting.pop())
        waiting += (everywhere(programs[name]) & programs.keys()) - reached
    assert programs.keys() - reached == set()
