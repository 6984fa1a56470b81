"""Built-in bonds of films: glues and double-sided tapes, each number with its source."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from geometry.common.errors import InputError, describe_choices
from geometry.common.json_types import JsonObject
from geometry.scenes.catalogue import MAX_DEVIATIONS
from geometry.scenes.quantities import THICKNESS_QUANTITY
from geometry.scenes.sourced_numbers import Number, format_comment, format_toml
from geometry.scenes.units import MODULUS_QUANTITY, format_modulus

BOND_SIDES = ("bond_to_block", "bond_to_base")
BOND_NUMBERS = ("thickness", "youngs_modulus", "poisson_ratio", "loss_factor")  # that a name in the catalogue stands for
TABLE = "probe.film.bond_to_base"


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
        By key of ``BOND_NUMBERS``, as a scene file has them; a rigid bond has a thickness of 0 alone.
    log_sd
        Standard deviation of ln of the modulus until the bond is measured; 0 for a rigid one.
    tolerance
        The source of ``log_sd``.
    """

    name: str
    about: str
    numbers: dict[str, Number]
    log_sd: float
    tolerance: str

    @property
    def kind(self) -> str:
        """Its use, beside those of materials."""
        return "bond"

    @property
    def youngs_modulus(self) -> float | None:
        """Young's modulus, Pa; None for a rigid bond."""
        number = self.numbers.get("youngs_modulus")
        return None if number is None else MODULUS_QUANTITY.read("youngs_modulus", number.value)

    @property
    def thickness(self) -> float:
        """Thickness of the layer, m; 0 for a rigid bond."""
        return THICKNESS_QUANTITY.read("thickness", self.numbers["thickness"].value)

    @property
    def table(self) -> dict[str, Number]:
        """The keys of a scene's table, the name first."""
        explanation = "the name alone does: the numbers below are the catalogue's, in whose place one may write measured ones"
        numbers = dict(self.numbers)
        if self.youngs_modulus is not None:
            modulus = numbers["youngs_modulus"]
            spread = f"standard deviation of ln E {self.log_sd:.2g}: {self.tolerance}"
            numbers["youngs_modulus"] = Number(modulus.value, modulus.source, spread)
        return {"name": Number(self.name, explanation), **numbers}

    def check_modulus(self, entry: object) -> None:
        """Raise ``InputError`` unless a measured modulus, text or Pa, is possible for this bond, as for a material."""
        remedy = "leave youngs_modulus out for the catalogue's, or name for another bond"
        if entry is not None and self.youngs_modulus is None:
            raise InputError("youngs_modulus", entry, f"none for {self.name}; {remedy}")
        try:
            modulus = MODULUS_QUANTITY.convert(entry, units_required=False)
        except (ValueError, OverflowError):
            return  # missing, or refused where the field is read
        assert self.youngs_modulus is not None
        reach = math.exp(MAX_DEVIATIONS * self.log_sd)
        if not 1 / reach <= modulus / self.youngs_modulus <= reach:
            ends = f"{format_modulus(self.youngs_modulus / reach)} to {format_modulus(self.youngs_modulus * reach)}"
            raise InputError("youngs_modulus", entry, f"{ends}, what {self.name} may measure; {remedy}")

    def as_dict(self) -> JsonObject:
        """Return the JSON object of ``probe-design material show``: SI numbers, a scene's table, where each number comes from."""
        numbers = {key: self.numbers[key].value if key in self.numbers else None for key in ("poisson_ratio", "loss_factor")}
        entry: JsonObject = {"name": self.name, "kind": self.kind, "about": self.about, "thickness": self.thickness}
        entry |= {"youngs_modulus": self.youngs_modulus, **numbers, "log_sd": self.log_sd, "tolerance": self.tolerance or None}
        entry["table"] = {TABLE: {key: number.value for key, number in self.table.items()}}
        return entry | {"sources": {key: number.description for key, number in self.table.items()}}

    def to_toml(self) -> str:
        """Return a table of a scene file, each number below a comment with its source."""
        head = [*format_comment(f"{self.name}: {self.about}"), f"[{TABLE}]  # as well [probe.film.bond_to_block]; of the"]
        head[-1] += " outer film alone [probe.film.outer.bond_to_base]"
        return "\n".join([*head, *format_toml(self.table), ""])


@cache
def list_bonds() -> dict[str, CatalogueBond]:
    """Return all built-in bonds by name."""
    tables = tomllib.loads(files("geometry.scenes").joinpath("bonds.toml").read_text(encoding="utf-8"))
    shared = {"tape": tables.pop("tape")}  # what holds for all bonds of a kind
    return {name: _build_bond(name, shared.get(table.get("kind"), {}) | table) for name, table in tables.items()}


def _build_bond(name: str, table: JsonObject) -> CatalogueBond:
    """Return a bond from its table in the file."""
    tolerance = table.get("tolerance", {"value": 0.0, "source": ""})
    numbers = {key: Number(**table[key]) for key in BOND_NUMBERS if key in table}
    return CatalogueBond(name, table["about"], numbers, tolerance["value"], tolerance["source"])


def find_bond(name: str) -> CatalogueBond:
    """Return a built-in bond.

    Raises
    ------
    InputError
        No bond has that name.
    """
    if name not in list_bonds():
        raise InputError("name", name, describe_choices(name, list_bonds()))
    return list_bonds()[name]


def fill_in_bond(table: object) -> object:
    """Return a bond's table, completed by the catalogue's entry for its key ``name``; numbers that the table has stay.

    Raises
    ------
    InputError
        No bond has that name, or the modulus beside it is not possible for it.
    """
    if not isinstance(table, Mapping) or not isinstance(table.get("name"), str):
        return table
    bond = find_bond(table["name"])
    bond.check_modulus(table.get("youngs_modulus"))
    return {key: number.value for key, number in bond.numbers.items()} | dict(table)
