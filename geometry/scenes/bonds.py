"""Built-in bonds of films: glues and double-sided tapes, each number with its source."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from geometry.common.errors import InputError, describe_choices
from geometry.scenes.sourced_numbers import Number

BOND_KEYS = ("thickness", "youngs_modulus", "poisson_ratio", "loss_factor")


@dataclass(frozen=True)
class CatalogueBond:
    """A bond to buy.

    Attributes
    ----------
    name
        As in the catalogue.
    about
        What it is.
    numbers
        By key of ``BOND_KEYS``, as a scene file has them; a rigid bond has a thickness of 0 alone.
    log_sd
        Standard deviation of ln of the modulus until the bond is measured; 0 for a rigid one.
    """

    name: str
    about: str
    numbers: dict[str, Number]
    log_sd: float


@cache
def read_bonds() -> dict[str, CatalogueBond]:
    """Return all built-in bonds by name."""
    tables = tomllib.loads(files("geometry.scenes").joinpath("bonds.toml").read_text(encoding="utf-8"))
    return {
        name: CatalogueBond(
            name, table["about"], {key: Number(**table[key]) for key in BOND_KEYS if key in table}, table["log_sd"]
        )
        for name, table in tables.items()
    }


def find_bond(name: str) -> CatalogueBond:
    """Return a built-in bond.

    Raises
    ------
    InputError
        No bond has that name.
    """
    if name not in read_bonds():
        raise InputError("name", name, describe_choices(name, read_bonds()))
    return read_bonds()[name]


def fill_in_bond(table: object) -> object:
    """Return a bond's table, completed by the catalogue's entry for its key ``name``; numbers that the table has stay.

    Raises
    ------
    InputError
        No bond has that name.
    """
    if not isinstance(table, Mapping) or not isinstance(table.get("name"), str):
        return table
    return {key: number.value for key, number in find_bond(table["name"]).numbers.items()} | dict(table)
