"""The commands `tissue` and `material`, which show built-in numbers with their sources, and `rerun`, which repeats a command."""

from __future__ import annotations

import math
import shlex
from pathlib import Path
from typing import Annotated

from geometry.scenes.catalogue import CatalogueMaterial
from geometry.scenes.catalogue_entries import find_entry, list_entries
from geometry.scenes.catalogue_laws import describe_law
from geometry.scenes.units import format_modulus
from probe_design.commands.output import print_json
from probe_design.commands.request import Number, Option, Request
from probe_design.terminal.console import warn, write_message

Name = Annotated[str, Option("Name in the list.", is_argument=True)]


class TissueListRequest(Request):
    """List the built-in tissues."""

    def run(self) -> None:
        """Print the tissues' names and descriptions."""
        from probe_design.data.tissues import read_tissues

        descriptions = {name: entry.about for name, entry in read_tissues().items()}
        if self.as_json:
            print_json({"tissues": descriptions})
            return
        for name, description in descriptions.items():
            print(f"{name:16}{description}")


class TissueShowRequest(Request):
    """Print the table [tissue] of NAME for a scene file; a comment above each number gives its scatter and source."""

    name: Name

    def run(self) -> None:
        """Print one tissue, as JSON or as a table for a scene file."""
        from probe_design.data.tissues import find_tissue

        entry = find_tissue(self.name)
        if self.as_json:
            print_json(entry.as_dict())
        else:
            print(entry.toml(), end="")


class MaterialListRequest(Request):
    """List the built-in materials and bonds: Young's modulus, its spread, the law, a description.

    The spread is the standard deviation of the modulus's logarithm, in percent.

    The law is the one at finite strain: "yeoh to 100 %" where a curve was measured up to that strain, else neo-hookean.
    """

    def run(self) -> None:
        """Print one line for each material and bond."""
        catalogue = list_entries()
        if self.as_json:
            keys = ("kind", "about", "youngs_modulus", "poisson_ratio", "log_sd", "law", "recipe")
            full_entries = {name: entry.as_dict() for name, entry in catalogue.items()}
            print_json({"materials": {name: {key: entry.get(key) for key in keys} for name, entry in full_entries.items()}})
            return
        for name, entry in catalogue.items():
            modulus = (
                "" if entry.youngs_modulus is None else f"{format_modulus(entry.youngs_modulus)}  ± {100 * entry.log_sd:.0f} %"
            )
            law = describe_law(entry.law) if isinstance(entry, CatalogueMaterial) and entry.kind == "elastomer" else ""
            print(f"{name:22}{entry.kind:10}{modulus:>20}  {law:14} {entry.about}")


class MaterialShowRequest(Request):
    """Print a table of NAME, a material or bond, for a scene file, with comments on tolerance, sources, methods, licences."""

    name: Name
    thinner: Annotated[
        Annotated[float, Number("a share of thinner, such as 0.2 or 20 %", math.isfinite, percent=True)] | None,
        Option("Fraction of thinner of an Ecoflex, such as 20 %."),
    ] = None
    ratio: Annotated[
        Annotated[float, Number("parts of base to one of agent, such as 20", math.isfinite)] | None,
        Option("Parts of base to one of agent of Sylgard 184, such as 20."),
    ] = None

    def run(self) -> None:
        """Print one material or bond, as JSON or as a table for a scene file."""
        entry = find_entry(self.name, thinner=self.thinner, ratio=self.ratio)
        if self.as_json:
            print_json(entry.as_dict())
        else:
            print(entry.to_toml(), end="")


class RerunRequest(Request):
    """Repeat the command that made FILE, and report whether its numbers still agree.

    FILE is the output of --json, an optimum's design.toml, a report, or the folder of optimize, sweep, tradeoff or export. Its
    block of provenance names the command and the scene. The scene's file must be present, unchanged, in the current folder or in
    that of FILE. Two numbers agree within the error estimates of both, or without these to 1 part in a million; seconds and
    versions are not compared.

    The exit code is 0 where all agree, 1 where one differs, 2 where FILE has no block of provenance.
    """

    file: Annotated[Path, Option("File, or folder of files.", is_argument=True)]

    def run(self) -> None:
        """Repeat the command, and exit with 1 where a number differs."""
        from probe_design.commands.main import cli
        from probe_design.repetition.rerun import rerun

        result = rerun(self.file, cli)
        if self.as_json:
            print_json(result.as_dict())
        else:
            for difference in result.differences:
                print(difference)
            print(f"{result.numbers} values compared: {'all agree' if result.agrees else f'{len(result.differences)} differ'}")
            warn(result.warnings)
        write_message(f"made by: {shlex.join(['probe-design', *result.command])}")
        if not result.agrees:
            raise SystemExit(1)
