"""What texts name: files, modules and commands in docstrings, comments and pages; found without importing anything."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tests.support.imports import OURS, statements
from tests.support.paths import ROOT

TOP = (*OURS, "docs", "examples")
_PATH = re.compile(r"(?<![\w./:<*\[-])[\w.*-]+(?:/[\w.*-]+)*\.(?:py|md|toml|json|npz|rules)(?![\w(])")
_FOLDER = re.compile(rf"(?<![\w./:-])(?:{'|'.join(TOP)})/[\w./*-]*\w")
_MODULE = re.compile(rf"(?<![\w./-])(?:{'|'.join(OURS)})(?:\.[A-Za-z_]\w*)+")
_COMMAND = re.compile(rf"-m ((?:{'|'.join(OURS)})[\w.]*\w)")


@cache
def texts(path: Path) -> tuple[str, ...]:
    """Docstrings and comments of a source, and what looks like a comment inside its strings."""
    source = path.read_text(encoding="utf-8")
    alone = (node.value for node in statements(ast.parse(source)) if isinstance(node, ast.Expr))
    values = (str(node.value) for node in alone if isinstance(node, ast.Constant))
    return *values, *re.findall(r"(?:^|\s)#.*", source)


def files(text: str) -> list[str]:
    """Files and folders that a text names, in its order: with a slash, or the bare name of a source."""
    matches = {match.start(): match[0] for pattern in (_FOLDER, _PATH) for match in pattern.finditer(text)}
    return [name for _, name in sorted(matches.items()) if "/" in name or name.endswith(".py")]


def modules(text: str) -> set[str]:
    """Dotted names under our packages."""
    return {name for name in _MODULE.findall(text) if not files(name)}


def commands(text: str) -> set[str]:
    """Modules that a text says to run."""
    return set(_COMMAND.findall(text))


def exists(path: Path) -> bool:
    """Whether a file or folder is there, from the root; ``*`` stands for anything."""
    return any(ROOT.glob(str(path)))


@cache
def resolves(name: str) -> bool:
    """Whether a dotted name is a module of ours, or something that one defines or imports, to any depth of classes."""
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        path = ROOT.joinpath(*parts[:k])
        source = path.with_suffix(".py") if path.with_suffix(".py").exists() else path / "__init__.py"
        if source.exists():
            return _defined(ast.parse(source.read_bytes()).body, parts[k:])
    return False


def runs(name: str) -> bool:
    """Whether ``python -m`` finds a program of that name."""
    path = ROOT.joinpath(*name.split("."))
    return path.with_suffix(".py").exists() or (path / "__main__.py").exists()


def _defined(body: list[ast.stmt], names: list[str]) -> bool:
    if not names:
        return True
    for node in body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == names[0]:
            return len(names) == 1 or _defined(node.body, names[1:])
        if len(names) == 1 and names[0] in _bound(node):
            return True
        if isinstance(node, ast.If) and _defined(node.body, names):
            return True
    return False


def _bound(node: ast.stmt) -> set[str]:
    """Names that an assignment or an import binds."""
    if isinstance(node, ast.Import | ast.ImportFrom):
        return {alias.asname or alias.name for alias in node.names}
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return {name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)}


def paths(page: str) -> Iterator[Path]:
    """Files and folders that a page names, from the root.

    Left out are blocks of code, whose files are the reader's, and targets of links. A bare name lies where the last path before
    it in the same line or table cell does, or else in the folder that its section's heading names.
    """
    section = Path()
    for line in re.sub(r"(?s)```.*?```|\]\([^)]*\)", "", page).splitlines():
        section = section if not line.startswith("#") else Path(*files(line)[-1:])
        for cell in line.split("|"):
            folder = section
            for name in files(cell):
                path = Path(name) if "/" in name else folder / name
                folder = path.parent if path.suffix else path
                yield path
