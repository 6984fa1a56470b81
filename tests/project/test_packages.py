"""Packages are small and one level deep, files are short, and tests mirror the packages."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.support.code_lines import count_code_lines
from tests.support.imports import sources
from tests.support.paths import ROOT

TOP_LEVEL = ("geometry", "hw", "probe_design", "solver")  # what users import by these names
CODE = (*TOP_LEVEL, "benchmarks")
MAX_FILE_LINES = 400  # a longer file holds more than one subject


def packages(top: str) -> list[Path]:
    return sorted({path.parent for path in sources(top)} - {ROOT / top})


@pytest.mark.parametrize("top", CODE)
def test_packages_are_one_level_deep(top: str) -> None:
    assert packages(top)
    for package in packages(top):
        assert package.parent == ROOT / top, package
        assert (package / "__init__.py").exists(), package


@pytest.mark.parametrize("folder", [*CODE, "tests", "examples"])
def test_no_file_is_long(folder: str) -> None:
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in sources(folder)}
    assert [str(path) for path, lines in lengths.items() if lines > MAX_FILE_LINES] == []


@pytest.mark.parametrize("top", CODE)
def test_a_package_states_its_purpose_and_imports_nothing(top: str) -> None:
    """One module of a package can be imported without the others."""
    for path in (ROOT / top).rglob("__init__.py"):
        tree = ast.parse(path.read_bytes(), str(path))
        assert ast.get_docstring(tree), path
        assert len(tree.body) == 1 or path.parent.relative_to(ROOT).as_posix() in TOP_LEVEL, path


@pytest.mark.parametrize("top", TOP_LEVEL)
def test_tests_mirror_the_packages(top: str) -> None:
    folders = {path.parent.relative_to(ROOT / "tests") for path in (ROOT / "tests" / top).rglob("test_*.py")}
    assert folders
    assert folders <= {Path(top), *(package.relative_to(ROOT) for package in packages(top))}


def test_code_lines_leave_out_blanks_comments_and_docstrings() -> None:
    assert (
        count_code_lines('"""Text."""\n\n# note\nx = (\n    1,\n)\n\n\ndef f():\n    """Text\n    on."""\n    return x  # note\n')
        == 5
    )
