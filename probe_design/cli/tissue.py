"""``probe-design tissue list`` and ``tissue show``."""

from __future__ import annotations

import click

from probe_design.cli.arguments import NamedCommands
from probe_design.cli.output import print_json


@click.group(cls=NamedCommands)
def tissue() -> None:
    """List and show built-in tissues: breast, forearm, a phantom; every number with its source.

    \b
    probe-design tissue list
    probe-design tissue show breast       the [tissue] table for a scene file
    """  # noqa: D301


@tissue.command("list")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def listed(as_json: bool) -> None:
    """List the built-in tissues."""
    from probe_design.data.tissues import tissues

    found = {name: one.about for name, one in tissues().items()}
    if as_json:
        print_json({"tissues": found})
        return
    for name, about in found.items():
        print(f"{name:10}{about}")


@tissue.command("show")
@click.argument("name")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def shown(name: str, as_json: bool) -> None:
    """Print the table [tissue] of NAME, ready for a scene file: each number below its scatter and source."""
    from probe_design.data.tissues import tissue as find

    found = find(name)
    if as_json:
        print_json(found.as_dict())
    else:
        print(found.toml(), end="")
