"""How the best design goes to the workshop: the command that writes its package, for the page and for the terminal."""

from __future__ import annotations

import shlex
from pathlib import Path

from probe_design.reports.page import Code, Text

DESIGN, PACKAGE = "design.toml", "workshop"  # in the folder of an optimisation: its answer, and a place for the package
FOR_THE_WORKSHOP = (
    Text(
        "The workshop gets more than the solids: dimensioned drawings with tolerances, film patterns, moulds, bill of materials "
        "and the order of assembly. In this folder"
    ),
    Code(f'probe-design export {DESIGN} -o {PACKAGE} --step "0.1 mm"'),
    Text("writes them, rounded to what is machined, and says what the rounding costs; without --step sizes stay as they are."),
)


def export_command(folder: Path) -> str:
    """Return the command that writes the package of the design that an optimisation has left in a folder."""
    return f"probe-design export {shlex.quote(str(folder / DESIGN))} -o {shlex.quote(str(folder / PACKAGE))}"
