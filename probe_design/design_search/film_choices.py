"""List the films and bonds that a search tries one by one: catalogue names, or thicknesses of the scene's own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

from geometry.common.errors import InputError, Words, describe_choices
from geometry.scenes.bonds import BOND_SIDES, find_bond
from geometry.scenes.catalogue import list_materials
from geometry.scenes.film import Film
from geometry.scenes.quantities import LENGTH_QUANTITY
from geometry.scenes.scene import Scene
from geometry.scenes.units import SI_CONTEXT
from probe_design.design_search.variables import list_lengths
from probe_design.populations.design_file import Design
from probe_design.populations.entries import DesignVariable
from probe_design.populations.tables import Protocol

FILM_KEYS = ("thickness", "youngs_modulus", "d31", "d33")  # of a catalogue film; the scene's other numbers stay
EXCLUSIVE_KEYS = (("film", "film_thickness"), ("bond", *BOND_SIDES), ("bond_thickness", "bond", *BOND_SIDES))


@dataclass(frozen=True)
class FilmChoice:
    """The films of a probe with their bonds.

    Attributes
    ----------
    values
        What was chosen, by the variable of the design file: a name, or a thickness with its unit.
    film
        The films.
    """

    values: Mapping[str, str]
    film: Film

    @property
    def description(self) -> str:
        """The choice in words."""
        return ", ".join(f"{name} {value}" for name, value in self.values.items())

    @property
    def texts(self) -> dict[str, str]:
        """The choice by the names of its columns in a table."""
        return {name.replace("_", " "): value for name, value in self.values.items()}

    def is_of(self, scene: Scene, _protocol: Protocol) -> bool:
        """Return whether a scene's probe has these films."""
        return scene.probe.film == self.film

    def set_film(self, scene: Scene) -> Scene:
        """Return a scene with these films."""
        return scene.model_copy(update={"probe": scene.probe.model_copy(update={"film": self.film})})


def list_film_choices(design: Design) -> tuple[FilmChoice, ...]:
    """Return all combinations of the films and bonds that a design file allows; none where it names no such variable.

    Raises
    ------
    InputError
        The catalogue has no such film or bond, two variables exclude each other, or the scene reads stresses.
    """
    variables = {
        name: values
        for name in ("film", "film_thickness", "bond", *BOND_SIDES, "bond_thickness")
        if (values := _list_values(name, getattr(design.variables, name)))
    }
    if not variables:
        return ()
    name = next(iter(variables))
    if design.scene.observable == "stress":
        allowed = "a scene that reads charges: [protocol] observable = 'charge'"
        raise InputError(f"variables.{name}", Words("given for a scene that reads stresses"), allowed)
    for first, *others in EXCLUSIVE_KEYS:
        for other in others:
            if first in variables and other in variables:
                raise InputError(f"variables.{other}", Words(f"given beside {first}"), "one of both")
    film = design.scene.probe.film
    without_effect = [name for name in variables if name != "film"]
    if film is not None and film.uses_psi and without_effect:
        allowed = "a scene without both: by eq. (12) a charge is the same whatever thickness and bonds"
        raise InputError(f"variables.{without_effect[0]}", Words("given beside psi1 or psi2"), allowed)
    tables = design.scene.probe.model_dump(exclude_unset=True).get("film") or {}
    if "bond_thickness" in variables and not any(_list_thick_bonds(part) for part in (tables, tables.get("outer"))):
        allowed = "a scene whose [probe.film] has a bond with a thickness, or bond in its place"
        raise InputError("variables.bond_thickness", Words("given"), allowed)
    return tuple(_build_choice(tables, dict(zip(variables, values, strict=True))) for values in product(*variables.values()))


def _list_values(name: str, variable: DesignVariable | tuple[str, ...]) -> tuple[str | float, ...]:
    """Return the names or thicknesses, m, that a variable allows; none where the scene's own stays."""
    if isinstance(variable, tuple):
        return tuple(dict.fromkeys(variable))
    return list_lengths(name, variable)


def _build_choice(tables: Mapping[str, Any], values: Mapping[str, Any]) -> FilmChoice:
    """Return a choice of films.

    Parameters
    ----------
    tables
        The scene's table ``[probe.film]``, SI.
    values
        The chosen names and thicknesses, m, by their variables.
    """
    changes: dict[str, Any] = {}
    outer, own_bonds = tables.get("outer") or {}, dict[str, Any]()
    for name, value in values.items():
        if name == "film":
            changes |= _read_film(value)
        elif name == "film_thickness":
            changes["thickness"] = value
        elif name == "bond_thickness":
            changes |= {side: {**bond, "thickness": value} for side, bond in _list_thick_bonds(tables).items()}
            own_bonds = {side: {**bond, "thickness": value} for side, bond in _list_thick_bonds(outer).items()}
        else:
            for side in BOND_SIDES if name == "bond" else (name,):
                changes[side] = {"name": _find_bond_name(name, value)}
    film = {**tables, **changes}
    # what differs on the outer block stays, unless it is chosen for both
    kept = {
        key: number for key, number in outer.items() if key not in changes or ("bond_thickness" in values and key in BOND_SIDES)
    }
    outer = kept | own_bonds
    film = {key: number for key, number in film.items() if key != "outer"} | ({"outer": outer} if outer else {})
    texts = {name: value if isinstance(value, str) else LENGTH_QUANTITY.format_value(value) for name, value in values.items()}
    return FilmChoice(texts, Film.model_validate(film, context=SI_CONTEXT))


def _list_thick_bonds(tables: Mapping[str, Any] | None) -> dict[str, Mapping[str, Any]]:
    """Return the bonds of a table of a film, or of what differs on the outer block, that are not rigid, by their sides."""
    sides = {side: (tables or {}).get(side) for side in BOND_SIDES}
    return {side: bond for side, bond in sides.items() if bond is not None and bond["thickness"] > 0}


def _read_film(name: str) -> dict[str, Any]:
    """Return the numbers of a catalogue film, as a scene file has them; raise ``InputError`` where it is none."""
    films = {key: material for key, material in list_materials().items() if material.kind == "film"}
    if name not in films:
        raise InputError("variables.film", name, f"{describe_choices(name, films)}; thicknesses alone are film_thickness")
    material = films[name]
    numbers = {key: material.numbers[key].value for key in FILM_KEYS if key in material.numbers}
    return numbers | {"youngs_modulus": material.youngs_modulus}


def _find_bond_name(variable: str, name: str) -> str:
    """Return the name of a bond that the catalogue has; raise ``InputError`` where it has none."""
    try:
        return find_bond(name).name
    except InputError as fault:
        raise InputError(f"variables.{variable}", name, fault.allowed) from None
