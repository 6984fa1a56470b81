"""No function takes more than five arguments by position: a longer call cannot be read without its names."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.support.imports import statements
from tests.support.paths import ROOT

PACKAGES = ("geometry", "solver", "probe_design", "hw")
MOST = 5
OUTSIDE = {
    "hw/simulation/virtual.py: ctrl_transfer": "pyusb's backend calls it by position",
}


def functions(package: str) -> Iterator[tuple[Path, ast.FunctionDef | ast.AsyncFunctionDef]]:
    for path in sorted((ROOT / package).rglob("*.py")):
        for node in statements(ast.parse(path.read_bytes(), str(path))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield path, node


def is_verb(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether click calls it, always by keyword."""
    return any(
        "click." in ast.unparse(decorator) or ".command(" in ast.unparse(decorator) for decorator in function.decorator_list
    )


def by_position(function: ast.FunctionDef | ast.AsyncFunctionDef) -> list[str]:
    names = [argument.arg for argument in (*function.args.posonlyargs, *function.args.args)]
    return names[1:] if names[:1] in (["self"], ["cls"]) else names


@cache
def long_signatures(package: str) -> set[str]:
    return {
        f"{path.relative_to(ROOT).as_posix()}: {function.name}"
        for path, function in functions(package)
        if len(by_position(function)) > MOST and not is_verb(function)
    }


@pytest.mark.parametrize("package", PACKAGES)
def test_long_argument_lists_are_named(package: str) -> None:
    assert long_signatures(package) - OUTSIDE.keys() == set()


def test_exceptions_exist() -> None:
    assert OUTSIDE.keys() <= {line for package in PACKAGES for line in long_signatures(package)}
