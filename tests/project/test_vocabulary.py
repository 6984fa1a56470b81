"""Names that a stranger reads: no bare pronouns and prepositions, verbs for functions, constants that say what they are of."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tests.support.imports import sources
from tests.support.paths import ROOT

PRODUCT = ("geometry", "solver", "probe_design", "hw")
RIDDLES = {"one", "found", "told", "asked", "of", "by", "on", "at", "here", "own", "rest", "near", "most", "least"}
FIXED = {
    "geometry/cad/parts_record.py: PartsRecord.asked": "a key of parts.json",
    "probe_design/built_probe/bench.py: Reference.on": "a key of bench files",
    "probe_design/built_probe/calibration_record.py: ReadingRecord.on": "a key of calibrations",
    "probe_design/commands/maps.py: ScanRequest.at": "the option --at",
    "probe_design/commands/maps.py: scan.at": "the keyword of the public function",
    "probe_design/design_search/pareto.py: Point.at": "a JSON key of fronts",
    "probe_design/estimation/estimate_result.py: ExpectedInterval.told": "a JSON key of estimate --next",
    "probe_design/maps/scan.py: Scan.at": "a JSON key of scan",
    "solver/results/load_limits.py: LargestLoad.by": "a JSON key of linear_limit_load and gap_closure_load",
}
PARTICIPLE = re.compile(r"^_*[a-z]+(ed|wn|lt|ept|ought|ound)$")
FUNCTIONS = {
    "embed",
    "speed",
    "seed",
    "feed",
    "bound",
    "need",
    "exceed",
    "proceed",
    "spread",
    "read",
    "bed",
    "shed",
    "round",
    "melt",
    "tilt",
}
MAX_MEANINGS = 2  # places in which a constant of one word may be defined


def bindings(path: Path) -> Iterator[tuple[str, str, ast.AST]]:
    """Yield what a source binds: its scope, its name and the node."""

    def visit(node: ast.AST, scope: tuple[str, ...]) -> Iterator[tuple[str, str, ast.AST]]:
        for child in ast.iter_child_nodes(node):
            inner = scope
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                yield ".".join(scope), child.name, child
                inner = (*scope, child.name)
            elif isinstance(child, ast.Name) and isinstance(child.ctx, ast.Store):
                yield ".".join(scope), child.id, child
            elif isinstance(child, ast.arg):
                yield ".".join(scope), child.arg, child
            elif isinstance(child, ast.Attribute) and isinstance(child.ctx, ast.Store):
                yield ".".join(scope), child.attr, child
            yield from visit(child, inner)

    yield from visit(ast.parse(path.read_bytes(), str(path)), ())


@cache  # every source is parsed once for all tests of this file
def named() -> list[tuple[str, str, str, tuple[str, ...] | None]]:
    """Return file, scope and name of all bindings, with the decorators of those that are functions."""
    return [
        (path.relative_to(ROOT).as_posix(), scope, name, decorators(node))
        for package in PRODUCT
        for path in sources(package)
        for scope, name, node in bindings(path)
    ]


def decorators(node: ast.AST) -> tuple[str, ...] | None:
    functions = (ast.FunctionDef, ast.AsyncFunctionDef)
    return tuple(map(ast.unparse, node.decorator_list)) if isinstance(node, functions) else None


def test_no_name_is_a_riddle() -> None:
    riddles = {f"{file}: {scope}.{name}".replace(": .", ": ") for file, scope, name, _ in named() if name.strip("_") in RIDDLES}
    assert riddles - FIXED.keys() == set()


def test_functions_are_not_participles() -> None:
    properties = {"property", "cached_property", "functools.cached_property"}
    participles = {
        f"{file}: {name}"
        for file, _, name, decorators in named()
        if decorators is not None
        and PARTICIPLE.match(name)
        and name.strip("_") not in FUNCTIONS
        and properties.isdisjoint(decorators)
    }
    assert participles == set()


def test_constants_say_what_they_are_of() -> None:
    places = defaultdict(set)
    for file, scope, name, _ in named():
        if not scope and len(name) > 1 and name.strip("_").isupper() and "_" not in name.strip("_"):
            places[name].add(file)
    assert {name: sorted(files) for name, files in places.items() if len(files) > MAX_MEANINGS} == {}
