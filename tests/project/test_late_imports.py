"""Imports inside functions: only of what is slow to load, and each package states the reason at its top."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.support.imports import OURS, blocks, imported, module, sources, statements
from tests.support.paths import ROOT

TOP_LEVEL = ("geometry", "solver", "probe_design", "hw")
LEAD = "# Imports inside functions: "
SLOW_STANDARD = {"asyncio", "concurrent", "importlib.metadata", "multiprocessing", "sqlite3", "subprocess"}
ABSENT_ON_WINDOWS = {"resource"}
# loaded before a command is known, or for its --help: what they ask for of ours waits, whatever it loads
START = ("probe_design", "probe_design.__main__", "probe_design.commands")
FILES = {module(path): path for top in TOP_LEVEL for path in sources(top)}
PACKAGES = sorted({path.parent for path in FILES.values()})
FUNCTION = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_bytes(), str(path))


def loading(node: ast.AST) -> Iterator[ast.AST]:
    """Statements that run on import, without those under a condition: for types, or in a notebook."""
    for child in blocks(node):
        if not isinstance(child, FUNCTION | ast.If):
            yield child
            yield from loading(child)


@cache
def late(path: Path) -> list[ast.Import | ast.ImportFrom]:
    functions = (node for node in statements(tree(path)) if isinstance(node, FUNCTION))
    imports = {node for function in functions for node in statements(function) if isinstance(node, ast.Import | ast.ImportFrom)}
    return sorted(imports, key=lambda node: node.lineno)


def with_parents(name: str) -> set[str]:
    parts = name.split(".")
    return {".".join(parts[:count]) for count in range(1, len(parts) + 1)}


@cache
def direct(name: str) -> frozenset[str]:
    """Modules that a module of ours loads itself, with their packages; nothing for a module of others."""
    path = FILES.get(name)
    names = set() if path is None else set(imported(loading(tree(path))))
    return frozenset().union(*(with_parents(loaded) for loaded in names))


@cache
def closure(name: str) -> frozenset[str]:
    """All modules that are loaded after the import of one, as far as our modules ask for them."""
    found, to_do = set[str](), with_parents(name)
    while to_do:
        loaded = to_do.pop()
        found.add(loaded)
        to_do |= direct(loaded) - found
    return frozenset(found)


def slow(names: set[str]) -> set[str]:
    """Libraries among modules, and slow modules of Python; SciPy loads each of its packages on its own."""
    roots = {name: name.split(".")[0] for name in names}
    libraries = {root for root in roots.values() if root not in OURS and root not in sys.stdlib_module_names}
    scipy = {name for name, root in roots.items() if root == "scipy" and "." in name}
    return libraries - {"scipy"} | scipy | names & (SLOW_STANDARD | ABSENT_ON_WINDOWS)


def must_wait(importer: str, name: str) -> bool:
    new = set(closure(name) - closure(importer))
    is_start = importer in START or importer.rpartition(".")[0] in START
    return bool(slow(set(closure(name))) - slow(set(closure(importer)))) or (is_start and any(part in FILES for part in new))


@pytest.mark.parametrize("top", TOP_LEVEL)
def test_only_what_is_slow_to_load_is_imported_inside_functions(top: str) -> None:
    wrong = [
        f"{path.relative_to(ROOT)}:{node.lineno}: {ast.unparse(node)}"
        for name, path in FILES.items()
        if path.is_relative_to(ROOT / top)
        for node in late(path)
        if not any(must_wait(name, target) for target in imported([node]))
    ]
    assert wrong == [], "these load nothing slow that their module has not: move them to its top"


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.relative_to(ROOT).as_posix())
def test_a_package_says_why_it_has_imports_inside_functions(package: Path) -> None:
    """In one comment under its docstring, which names the libraries of others; a package that has none has no comment."""
    nodes = [node for path in package.glob("*.py") for node in late(path)]
    comments = [line for line in (package / "__init__.py").read_text(encoding="utf-8").splitlines() if line.startswith(LEAD)]
    assert len(comments) == bool(nodes)
    libraries = {name.split(".")[0] for name in slow(set(imported(nodes)))}
    text = " ".join(comments)
    assert [name for name in libraries if name not in text] == []
    assert [str(path) for path in package.glob("[!_]*.py") if LEAD in path.read_text(encoding="utf-8")] == []


@pytest.mark.parametrize(
    ("importer", "name", "waits"),
    [
        ("geometry.cad.solids", "cadquery", True),
        ("solver.batch", "json", False),  # Python's
        ("solver.batch", "solver.planning.coarse_model", True),  # SciPy, three modules further on
        ("solver.equivalent_inclusion.strain_products", "scipy.ndimage", True),  # beside another package of SciPy
        ("probe_design.terminal.result_tables", "numpy", False),  # has it through the units of results
        ("probe_design.commands.evaluate", "probe_design.terminal.result_tables", True),
        ("probe_design.commands.evaluate", "pydantic", False),
        ("geometry.processes.child_main", "resource", True),
    ],
)
def test_what_must_wait(importer: str, name: str, waits: bool) -> None:
    assert must_wait(importer, name) is waits
