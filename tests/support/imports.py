"""Modules of ours, the subpackages they lie in, and what they import; found without importing any."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

from tests.support.paths import ROOT

OURS = ("geometry", "solver", "probe_design", "hw", "benchmarks", "tests")


def sources(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def module(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def find_subpackage(name: str) -> str:
    """Return the package of a module of ours and the folder in it."""
    parts = name.split(".")
    return ".".join(parts[: 1 + (ROOT / Path(*parts[:2])).is_dir()])


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield all statements below a node, to any depth, with the handlers and cases that hold them; expressions hold none.

    A tenth of the nodes that ``ast.walk`` visits.
    """
    for child in blocks(node):
        yield child
        yield from statements(child)


def blocks(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the statements, handlers and cases directly below a module, a statement, a handler or a case."""
    for field in ("body", "handlers", "orelse", "finalbody", "cases"):
        yield from getattr(node, field, ())


def imported(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Full names of the modules that these statements import, ``from package import module`` as module."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, "imports are absolute"
            folder = ROOT / str(node.module).replace(".", "/")
            names = {alias.name for alias in node.names}
            inner = {name for name in names if (folder / f"{name}.py").exists() or (folder / name).is_dir()}
            yield from (f"{node.module}.{name}" for name in inner)
            if inner < names:
                yield str(node.module)


@cache
def everywhere(path: Path) -> frozenset[str]:
    """Modules of ours that a source imports anywhere in it, for types too."""
    modules = imported(statements(ast.parse(path.read_bytes(), str(path))))
    return frozenset(name for name in modules if name.split(".")[0] in OURS)


def modules_after(code: str) -> set[str]:
    """Top-level modules in a fresh interpreter after running the code."""
    program = f"{code}; import sys; print(*{{name.split('.')[0] for name in sys.modules}})"
    run = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, cwd=ROOT, check=False)
    assert run.returncode == 0, run.stderr
    return set(run.stdout.split())
