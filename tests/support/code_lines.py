"""Count lines of code, without blanks, comments and docstrings: ``python -m tests.support.code_lines`` prints each package's."""

from __future__ import annotations

import ast
import io
import tokenize
from collections import Counter

from tests.support.imports import sources
from tests.support.paths import ROOT

PRODUCT = ("geometry", "solver", "probe_design", "hw")
LAYOUT_TOKENS = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def count_code_lines(text: str) -> int:
    """Return how many lines of a module hold code; an expression over several lines counts as so many."""
    tokens = [token for token in tokenize.generate_tokens(io.StringIO(text).readline) if token.type not in LAYOUT_TOKENS]
    lines = {line for token in tokens for line in range(token.start[0], token.end[0] + 1)}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node) is not None:
            lines -= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    return len(lines)


def count_packages() -> Counter[str]:
    """Return the lines of code of each package, and of each top-level one with all below it."""
    counts = Counter[str]()
    for top in PRODUCT:
        for path in sources(top):
            lines = count_code_lines(path.read_text(encoding="utf-8"))
            counts[top] += lines
            counts[path.parent.relative_to(ROOT).as_posix()] += lines if path.parent != ROOT / top else 0
    return counts


if __name__ == "__main__":
    packages = count_packages()
    print("\n".join(f"{packages[name]:6} {name}" for name in sorted(packages)))
    print(f"{sum(packages[top] for top in PRODUCT):6} all")
