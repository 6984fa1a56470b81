"""Write ``explanation/architecture.md``: the packages, what each is for, and the imports between them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "explanation" / "architecture.md"
TOP_LEVEL = ("geometry", "solver", "probe_design", "hw")
HEAD = """\
# Architecture

Four top-level packages import each other in one direction: `geometry <- solver <- probe_design -> hw`. `geometry` describes the
probe and its scene as shapes. `solver` turns a scene into stresses. `probe_design` designs, searches, estimates and calibrates,
and holds the command line. `hw` reads the built probe. `geometry` and `hw` import none of the others.

`tests/project/test_imports.py` states which package may import which, and why; it fails on any other import.

**A modulus on its way.** A scene file becomes a `Scene` (`geometry/scenes`). `solver.evaluate` asks `solver/planning` for the
cheapest evaluator that reaches the accuracy and for what it may leave out. The evaluator's package assembles and solves.
It returns a frozen `Result` (`solver/results`), which tables, reports and figures show.

**A sample on its way.** A device, file or virtual probe sends frames (`hw/usb`, `hw/serial_port`, `hw/oscilloscope`,
`hw/files`, `hw/simulation`). `hw/wire` decodes them. `hw/signal` fits the drive's sine and returns charges.
`probe_design/built_probe` turns charges into forces with their uncertainty, and `probe_design/estimation` turns readings
into a modulus, a diameter or a depth.

An arrow below points from a package to one that it imports. An arrow is left out where a longer way of arrows says the same.
Arrows into `geometry/common` and `geometry/scenes`, which nearly all packages import, are left out, too.

This page is what `python docs/make_architecture.py` prints: run it after a change of imports or of a package's docstring.
"""
EVERYWHERE = {"geometry/common", "geometry/scenes", "hw/common"}


def page() -> str:
    """Return the page: one diagram and one table for each top-level package."""
    parts = [HEAD]
    for top in TOP_LEVEL:
        parts += [f"## `{top}`\n", diagram(top), table(top)]
    return "\n".join(parts)


def packages(top: str) -> list[str]:
    """Return the packages below a top-level one, "solver/contact"."""
    return sorted(path.parent.relative_to(ROOT).as_posix() for path in (ROOT / top).glob("*/__init__.py"))


def purpose(package: str) -> str:
    """Return the first sentence of a package's docstring."""
    text = ast.get_docstring(ast.parse((ROOT / package / "__init__.py").read_bytes())) or ""
    return " ".join(text.split("\n\n")[0].split())


def imported_packages(package: str) -> Iterator[str]:
    """Yield what the modules of a package import, as packages, itself included."""
    for path in sorted((ROOT / package).glob("*.py")):
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in TOP_LEVEL:
                yield "/".join(node.module.split(".")[:2])


def arrows(top: str) -> dict[str, set[str]]:
    """Return the imports between the packages of a top-level one, without those that others imply."""
    names = set(packages(top)) - EVERYWHERE
    direct = {name: (set(imported_packages(name)) & names) - {name} for name in names}

    def reached(name: str) -> set[str]:
        return set().union(*({other} | reached(other) for other in direct[name]), set())

    return {name: needs - set().union(*(reached(other) for other in needs), set()) for name, needs in direct.items()}


def diagram(top: str) -> str:
    """Return the arrows of a top-level package as a Mermaid flow chart."""
    lines = ["```mermaid", "flowchart TD"]
    for name, needs in sorted(arrows(top).items()):
        short = name.split("/")[1]
        lines += [f"    {short} --> {other.split('/')[1]}" for other in sorted(needs)] or [f"    {short}"]
    return "\n".join([*lines, "```", ""])


def table(top: str) -> str:
    """Return the packages of a top-level one with their purposes."""
    rows = [f"| `{name}` | {purpose(name)} |" for name in packages(top)]
    return "\n".join(["| package | purpose |", "|---|---|", *rows, ""])


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
