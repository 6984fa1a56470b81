"""The documentation site: all pages are in its navigation, guides are short, and all that a reader may read has a limit."""

from __future__ import annotations

import importlib
import re
import sys

import pytest

from tests.support.paths import DOCS, ROOT

PAGES = {str(path.relative_to(DOCS)): path.read_text(encoding="utf-8") for path in sorted(DOCS.rglob("*.md"))}
GENERATED = {f"reference/{name}.md" for name in ("commands", "design-file", "equations", "python", "scene-file")}
GENERATED |= {"explanation/architecture.md", "evidence/extremes.md"}  # a benchmark prints the latter
MAX_WORDS = 30_000  # of prose, tables included
MAX_GUIDE_LINES = 150


def count_words(page: str) -> int:
    """Return the number of words of a page, without blocks of code, names of code and numbers."""
    prose = re.sub(r"`[^`\n]*`", " ", re.sub(r"```.*?```", "", page, flags=re.S))
    return len(re.findall(r"(?<![\w.])[A-Za-z][A-Za-z'-]+", prose))


def test_words_are_counted() -> None:
    assert count_words("The ratio's error, `error_estimate`, is 1 % | so |\n```\nprinted text\n```\n") == 5


def test_pages_are_short_together() -> None:
    words = {name: count_words(page) for name, page in PAGES.items() if name not in GENERATED}
    assert sum(words.values()) <= MAX_WORDS, sorted(words.items(), key=lambda row: -row[1])[:8]


@pytest.mark.parametrize("name", [name for name in PAGES if name.startswith("guides/")])
def test_guides_are_short(name: str) -> None:
    assert len(PAGES[name].splitlines()) <= MAX_GUIDE_LINES


def test_navigation_has_every_page() -> None:
    named = set(re.findall(r"[\w/-]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8")))
    assert PAGES.keys() <= named


def test_pipes_in_tables_of_code_have_no_backslash_on_the_site(monkeypatch: pytest.MonkeyPatch) -> None:
    """GitHub wants them escaped; MkDocs showed the backslash. Code outside tables is left alone."""
    pytest.importorskip("mkdocs")
    monkeypatch.setattr(sys, "path", [str(DOCS), *sys.path])
    hooks = importlib.import_module("site_hooks")
    assert hooks.unescape_pipes("| SC.1 | `over \\|y\\| < a` |\n\n`a \\| b`\n") == "| SC.1 | `over |y| < a` |\n\n`a \\| b`\n"
