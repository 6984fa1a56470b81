"""The command that writes the workshop package of an optimised design, for the report and the terminal."""

from __future__ import annotations

import shlex
from pathlib import Path

from probe_design.reporting.page import Code, Text

DESIGN_FILE, PACKAGE_FOLDER = "design.toml", "workshop"  # in the folder of an optimisation
NEXT_PARTS = (
    Text("In this folder: what the probe reads, which of its sizes to hold how closely, and the files for the workshop."),
    Code(
        f"probe-design evaluate {DESIGN_FILE}\nprobe-design tolerances {DESIGN_FILE}\n"
        f'probe-design export {DESIGN_FILE} -o {PACKAGE_FOLDER} --step "0.1 mm"'
    ),
    Text("When it has been built: probe-design calibrate, then probe-design check, with the same file."),
)
WORKSHOP_PARTS = (
    Text(
        "The package for the workshop has, besides the solids, dimensioned drawings with tolerances, film patterns, moulds, bill "
        "of materials and the order of assembly. In this folder"
    ),
    Code(f'probe-design export {DESIGN_FILE} -o {PACKAGE_FOLDER} --step "0.1 mm"'),
    Text(
        "writes it, with sizes rounded to a step that can be machined, and reports what the rounding costs. "
        "Without --step sizes are not rounded."
    ),
)


def build_export_command(folder: Path) -> str:
    """Return the command that writes the workshop package of the design in the folder of an optimisation."""
    return f"probe-design export {shlex.quote(str(folder / DESIGN_FILE))} -o {shlex.quote(str(folder / PACKAGE_FOLDER))}"


def build_evaluate_command(folder: Path) -> str:
    """Return the command that computes the reading of an optimised design."""
    return f"probe-design evaluate {shlex.quote(str(folder / DESIGN_FILE))}"
