"""The page of benchmarks: it lists all programs, and each of them states its purpose and duration."""

from pathlib import Path

import pytest

from docs.make_benchmarks import FOLDER, PAGE, find_duration, is_program, page

PROGRAMS = [path for path in sorted(FOLDER.rglob("*.py")) if is_program(path)]


def test_the_page_is_what_the_docstrings_say() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run python docs/make_benchmarks.py"


@pytest.mark.parametrize("path", PROGRAMS, ids=[str(path.relative_to(FOLDER)) for path in PROGRAMS])
def test_every_program_says_how_long_it_takes(path: Path) -> None:
    assert find_duration(path)
