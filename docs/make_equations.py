"""Write ``equations.md``, the list of all labelled equations, from what stands at their definitions in the packages."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "reference" / "equations.md"
ROOMS = {
    "SC": "geometry/scenes",
    "ME": "geometry/meridian",
    "TE": "geometry/tetra",
    "CA": "geometry/cad",
    "WS": "geometry/workshop",
    "RE": "solver/results",
    "LA": "solver/linalg",
    "PU": "solver/published",
    "LW": "solver/materials",
    "LY": "solver/layers",
    "CF": "solver/closed_form",
    "TW": "solver/tumour_waves",
    "IN": "solver/inclusions",
    "EL": "solver/elements",
    "AX": "solver/axisymmetric",
    "MS": "solver/multiple_scattering",
    "EI": "solver/equivalent_inclusion",
    "RT": "solver/reading_tables",
    "CT": "solver/contact",
    "SO": "solver/solid",
    "PH": "solver/phase",
    "PL": "solver/planning",
    "LG": "probe_design/inference",
    "PO": "probe_design/populations",
    "LO": "probe_design/locating",
    "DS": "probe_design/design_search",
    "MA": "probe_design/maps",
    "MF": "probe_design/material_fit",
    "TO": "probe_design/tolerancing",
    "ES": "probe_design/estimation",
    "TR": "probe_design/tradeoffs",
    "SW": "probe_design/sweeps",
    "BP": "probe_design/built_probe",
    "PC": "probe_design/probe_check",
    "RP": "probe_design/repetition",
    "WO": "probe_design/workshop",
    "SI": "hw/signal",
}
DEFINITION = re.compile(r"\(([A-Z]{2}\.\d+)\)")
HEAD = """\
# Equations

A label is its folder's letters and a number, and has one meaning in the whole tree. The parentheses make the difference: where an
equation is defined its label stands in parentheses right behind it, (CF.1); wherever else it is spoken of it is written
without, as in eq. CF.1. The numbers (1) to (12) are the paper's.

This page is what `python docs/make_equations.py` finds at the definitions: run it after every change of a label or its formula.
"""


@dataclass(frozen=True)
class Equation:
    """A labelled equation.

    Attributes
    ----------
    label
        Its package's letters, a dot and its number.
    says
        The formula or sentence at its definition.
    file
        That defines it, relative to the root.
    """

    label: str
    says: str
    file: str

    @property
    def order(self) -> tuple[int, int]:
        """Its place on the page: the package's and its number."""
        letters, number = self.label.split(".")
        return list(ROOMS).index(letters), int(number)


def equations() -> list[Equation]:
    """Find the definitions in all packages, by file."""
    files = (path for package in ("geometry", "solver", "probe_design", "hw") for path in sorted((ROOT / package).rglob("*.py")))
    return [
        Equation(label, says, path.relative_to(ROOT).as_posix())
        for path in files
        for label, says in definitions(path.read_text(encoding="utf-8"))
    ]


def definitions(text: str) -> Iterator[tuple[str, str]]:
    """Yield each label that a text defines with what it says: what stands before it, in a display line by line."""
    *parts, _ = DEFINITION.split(text)
    for text_before, label in zip(parts[::2], parts[1::2], strict=True):
        lines = [" ".join(line.strip(" #").split()) for line in sentence(text_before).replace("``", "").splitlines()]
        yield label, ("\n" if text_before.endswith("  ") else " ").join(lines).rstrip(" ,")


def sentence(text: str) -> str:
    """Return the sentence that a text ends with, which begins after a blank line at the earliest."""
    paragraph = re.split(r'\n\n|"""', text)[-1]
    return re.split(r"(?<!eq)(?<!eqs)\.\s+(?=[A-Z])", paragraph)[-1].strip()


def page() -> str:
    """Return the text of ``equations.md``."""
    ordered = sorted(equations(), key=lambda equation: equation.order)
    return "\n".join(
        [HEAD, *(table(letters, list(group)) for letters, group in groupby(ordered, lambda equation: equation.label[:2]))]
    )


def table(letters: str, group: list[Equation]) -> str:
    """Return one package's part of the page."""
    rows = [f"| {equation.label} | {code(equation.says)} | `{Path(equation.file).name}` |\n" for equation in group]
    return f"## {letters}: `{ROOMS[letters]}`\n\n| label | equation | file |\n|---|---|---|\n{''.join(rows)}"


def code(text: str) -> str:
    """Return lines as code in a table's cell, in which a bar must not end it."""
    return "<br>".join(f"`{line}`" for line in text.replace("|", r"\|").splitlines())


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
