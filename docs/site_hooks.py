"""Prepare pages for the site: pages from outside ``docs``, and links to files that are not part of the site.

MkDocs calls both functions by their names.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs"))

from notebook_pages import FOLDER, write_page  # noqa: E402 - a file beside this one, which MkDocs does not put on the path

PAGES = {"contributing.md": "CONTRIBUTING.md", "changelog.md": "CHANGELOG.md", "benchmarks.md": "benchmarks/README.md"}
TABLE_ROW = re.compile(r"^\|.*\|$", re.MULTILINE)
CODE = re.compile(r"`[^`\n]+`")
LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)#]+)(#[^)]*)?\)")


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the pages that lie outside ``docs`` to the site's files."""
    for name, source in PAGES.items():
        files.append(File.generated(config, name, content=(ROOT / source).read_text(encoding="utf-8")))
    for path in sorted((ROOT / FOLDER).glob("*.ipynb")):
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=write_page(path)))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Return a page's text with links to pages of the site, and paths in place of links to anything else in the repository."""
    source = ROOT / PAGES.get(page.file.src_uri, f"docs/{page.file.src_uri}")
    moved = {ROOT / path: name for name, path in PAGES.items()}
    moved |= {path: f"notebooks/{path.stem}.md" for path in (ROOT / FOLDER).glob("*.ipynb")}

    def rewrite(link: re.Match[str]) -> str:
        text, target, heading = link.group(1), link.group(2), link.group(3) or ""
        path = (source.parent / target).resolve()
        if "://" in target or not path.exists():
            return link.group(0)
        if path in moved or path.is_relative_to(ROOT / "docs"):
            name = moved.get(path) or str(path.relative_to(ROOT / "docs"))
            up = "../" * page.file.src_uri.count("/")
            return f"[{text}]({up}{name}{heading})"
        name = str(path.relative_to(ROOT))
        return text if Path(name).name in text else f"{text} (`{name}`)"

    return LINK.sub(rewrite, unescape_pipes(markdown))


def unescape_pipes(markdown: str) -> str:
    """Return a text whose code in tables has plain pipes, which Markdown on GitHub wants escaped and MkDocs shows escaped."""
    return TABLE_ROW.sub(lambda row: CODE.sub(lambda code: code.group(0).replace(r"\|", "|"), row.group(0)), markdown)
