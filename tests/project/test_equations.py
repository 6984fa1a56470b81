"""Labels of equations: one meaning each in the whole tree, its package's letters, and a page that lists them all."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from docs.make_equations import PAGE, ROOMS, definitions, equations, page
from tests.support.paths import ROOT

LABEL = re.compile(r"\b[A-Z]{2}\.\d+\b")
UNNAMED = re.compile(r"\b[Ee]qs?\.[\s#]+\(?[A-Z]\d+\b")  # a label without its package
FOLDERS = ("geometry", "solver", "probe_design", "hw", "benchmarks", "docs", "examples", "tests")
EQUATIONS = equations()


def texts() -> Iterator[tuple[Path, str]]:
    """All sources and pages but the list itself."""
    for path in (ROOT / "README.md", *(path for folder in FOLDERS for path in (ROOT / folder).rglob("*"))):
        if path.suffix in (".py", ".md") and path != PAGE:
            yield path.relative_to(ROOT), path.read_text(encoding="utf-8")


def test_each_label_is_defined_once() -> None:
    assert [label for label, count in Counter(equation.label for equation in EQUATIONS).items() if count > 1] == []


def test_every_label_referred_to_is_defined() -> None:
    defined = {equation.label for equation in EQUATIONS}
    uses = [(path, label) for path, text in texts() for label in LABEL.findall(text)]
    assert len(uses) > len(defined)
    assert [(path, label) for path, label in uses if label not in defined] == []


def test_labels_have_their_room_s_letters() -> None:
    assert [equation for equation in EQUATIONS if Path(equation.file).parent.as_posix() != ROOMS.get(equation.label[:2])] == []


def test_no_label_is_without_a_room() -> None:
    assert [(path, label) for path, text in texts() for label in UNNAMED.findall(text)] == []


def test_numbers_of_a_room_run_from_one() -> None:
    for letters in ROOMS:
        numbers = sorted(int(equation.label[3:]) for equation in EQUATIONS if equation.label[:2] == letters)
        assert numbers == list(range(1, len(numbers) + 1)), letters


def test_rooms_exist() -> None:
    assert [folder for folder in ROOMS.values() if not (ROOT / folder).is_dir()] == []


def test_page_is_what_the_script_prints() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run python docs/make_equations.py"


def test_a_definition_says_what_stands_before_it() -> None:
    text = '"""One. By eq. CF.1 two\nlines (CF.2); three.\n\n    x  = 1,\n    yy = 2,   (CF.3)\n"""'
    assert list(definitions(text)) == [("CF.2", "By eq. CF.1 two lines"), ("CF.3", "x = 1,\nyy = 2")]
