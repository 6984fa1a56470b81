"""Write ``benchmarks/README.md``: what each program measures, how long it takes and which page shows its figures."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "benchmarks"
PAGE = FOLDER / "README.md"
DURATION = re.compile(r"^Duration: (.+)\.$", re.MULTILINE)
HEAD = """\
# Benchmarks

Programs that measure what is too long for a test, and the independent codes that compute the reference scenes of
`tests/reference`. Run one from the repository's root, for example `python -m benchmarks.closed_form.speed`; `--help` lists its
options. Install the extra `bench` first (`pip install -e '.[bench]'`). Programs that compare with CalculiX need `ccx` (Debian:
`calculix-ccx`).

Durations are rough, for the defaults on two quiet cores. Programs marked "per scene" or "per probe" take as long as you let them.

`python docs/make_benchmarks.py` prints this page from the programs' docstrings: run it after a change of them.
"""


def page() -> str:
    """Return the page: one table for each folder."""
    parts = [HEAD]
    for folder in sorted(path.parent for path in FOLDER.glob("*/__init__.py")):
        lines = [_format_row(path) for path in sorted(folder.glob("*.py")) if is_program(path)]
        if lines:
            purpose = _get_docstring(folder / "__init__.py")
            parts.append(f"## `{folder.name}`\n\n{purpose}\n\n| program | purpose | duration | figures in |\n|---|---|---|---|")
            parts[-1] = "\n".join([parts[-1], *lines, ""])
    return "\n".join(parts).replace("``", "`")


def is_program(path: Path) -> bool:
    """Return whether a module can be run by ``python -m``."""
    return path.name == "__main__.py" or 'if __name__ == "__main__":' in path.read_text(encoding="utf-8")


def name_program(path: Path) -> str:
    """Return the name after ``python -m`` of a module."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__main__")


def find_duration(path: Path) -> str:
    """Return how long a program takes, as its docstring states.

    Raises
    ------
    ValueError
        The docstring has no line "Duration: ...".
    """
    duration = DURATION.search(_get_docstring(path))
    if duration is None:
        raise ValueError(f"{path.relative_to(ROOT)}: the docstring has no line 'Duration: ...'.")
    return duration.group(1)


def _format_row(path: Path) -> str:
    first_line = " ".join(_get_docstring(path).split("\n\n")[0].split())
    pages = ", ".join(f"[{page.name}](../{page.relative_to(ROOT).as_posix()})" for page in _find_pages(name_program(path)))
    return f"| `{name_program(path).removeprefix('benchmarks.')}` | {first_line} | {find_duration(path)} | {pages} |"


def _find_pages(program: str) -> list[Path]:
    """Return the pages that quote a program."""
    command = re.compile(rf"{re.escape(program)}(?![\w.])")
    pages = [*sorted((ROOT / "docs").rglob("*.md")), ROOT / "tests" / "reference" / "README.md"]
    return [path for path in pages if command.search(path.read_text(encoding="utf-8"))]


def _get_docstring(path: Path) -> str:
    return ast.get_docstring(ast.parse(path.read_bytes())) or ""


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
