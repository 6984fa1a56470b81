"""Rooms: small folders of small files, tests that mirror them, and one name for one thing."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

import pytest

from tests.support.imports import sources
from tests.support.paths import ROOT

PACKAGES = ("geometry", "hw", "probe_design", "solver")
CODE = (*PACKAGES, "benchmarks")
FACES = set(PACKAGES)  # what users import by these names
FEWEST, MOST = 2, 18  # sources of a room
LONGEST = 400  # lines


def rooms(package: str) -> list[Path]:
    return sorted({path.parent for path in sources(package)} - {ROOT / package})


def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_bytes(), str(path))


@pytest.mark.parametrize("package", CODE)
def test_rooms_are_small_and_one_deep(package: str) -> None:
    assert rooms(package)
    for room in rooms(package):
        assert room.parent == ROOT / package, room
        assert (room / "__init__.py").exists(), room
        assert FEWEST <= len(list(room.glob("*.py"))) <= MOST, room


@pytest.mark.parametrize("folder", [*CODE, "tests", "examples"])
def test_no_file_is_long(folder: str) -> None:
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in sources(folder)}
    assert [str(path) for path, lines in lengths.items() if lines > LONGEST] == []


@pytest.mark.parametrize("package", CODE)
def test_a_room_says_what_it_is_and_imports_nothing(package: str) -> None:
    """So that one module of a room can be had without the others."""
    for path in (ROOT / package).rglob("__init__.py"):
        tree = parsed(path)
        assert ast.get_docstring(tree), path
        assert len(tree.body) == 1 or path.parent.relative_to(ROOT).as_posix() in FACES, path


def test_class_names_are_unique() -> None:
    trees = [parsed(path) for package in CODE for path in sources(package)]
    names = Counter(node.name for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    assert [name for name, times in names.items() if times > 1] == []


@pytest.mark.parametrize("package", PACKAGES)
def test_tests_mirror_the_rooms(package: str) -> None:
    folders = {path.parent.relative_to(ROOT / "tests") for path in (ROOT / "tests" / package).rglob("test_*.py")}
    assert folders
    assert folders <= {Path(package), *(room.relative_to(ROOT) for room in rooms(package))}
