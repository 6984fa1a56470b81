"""The commands ``tissue list|show`` and ``material list|show``: built-in numbers with their sources."""

from __future__ import annotations

import click

from probe_design.cli.arguments import NamedCommands
from probe_design.cli.output import print_json

json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")


@click.group(cls=NamedCommands)
def tissue() -> None:
    """List and show built-in tissues: breast, forearm, a phantom; every number with its source.

    \b
    probe-design tissue list
    probe-design tissue show breast       the [tissue] table for a scene file
    """  # noqa: D301


@tissue.command("list")
@json_option
def print_tissue_names(as_json: bool) -> None:
    """List the built-in tissues."""
    from probe_design.data.tissues import read_tissues

    descriptions = {name: entry.about for name, entry in read_tissues().items()}
    if as_json:
        print_json({"tissues": descriptions})
        return
    for name, description in descriptions.items():
        print(f"{name:10}{description}")


@tissue.command("show")
@click.argument("name")
@json_option
def print_tissue(name: str, as_json: bool) -> None:
    """Print the table [tissue] of NAME for a scene file; a comment above each number gives its scatter and source."""
    from probe_design.data.tissues import find_tissue as find

    entry = find(name)
    if as_json:
        print_json(entry.as_dict())
    else:
        print(entry.toml(), end="")


@click.group(cls=NamedCommands)
def material() -> None:
    """List and show built-in materials: block elastomers, base plastics and metals, films, recipes; every number with its source.

    \b
    probe-design material list
    probe-design material show dragon-skin-30       the [probe.inner] table for a scene file
    probe-design material show ecoflex-00-10 --thinner 0.3
    """  # noqa: D301


@material.command("list")
@json_option
def print_material_names(as_json: bool) -> None:
    """List the built-in materials: Young's modulus, the standard deviation of its logarithm, a description."""
    from geometry.scenes.catalogue import format_modulus, list_materials

    catalogue = list_materials()
    if as_json:
        print_json({"materials": {name: _select_brief(entry.as_dict()) for name, entry in catalogue.items()}})
        return
    for name, entry in catalogue.items():
        print(f"{name:22}{entry.kind:11}{format_modulus(entry.youngs_modulus):>11}  +- {entry.log_sd:4.2f}  {entry.about}")


@material.command("show")
@click.argument("name")
@click.option("--thinner", help="Fraction of thinner of an Ecoflex, such as 0.3.")
@click.option("--ratio", help="Parts of base to one of agent of Sylgard 184, such as 20.")
@json_option
def print_material(name: str, thinner: str | None, ratio: str | None, as_json: bool) -> None:
    """Print a table of NAME for a scene file, with comments on tolerance, sources, test methods and licences."""
    from geometry.scenes.catalogue import find_material as find
    from probe_design.cli.arguments import read_number

    thinner_fraction = None if thinner is None else read_number("thinner", thinner, "a share of thinner, such as 0.3")
    parts = None if ratio is None else read_number("ratio", ratio, "parts of base to one of agent, such as 20")
    entry = find(name, thinner=thinner_fraction, ratio=parts)
    if as_json:
        print_json(entry.as_dict())
    else:
        print(entry.to_toml(), end="")


def _select_brief(entry: dict[str, object]) -> dict[str, object]:
    """Return the entries of a material that the list shows."""
    return {key: entry[key] for key in ("kind", "about", "youngs_modulus", "poisson_ratio", "log_sd", "recipe")}
