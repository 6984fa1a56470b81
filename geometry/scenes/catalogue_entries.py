"""List and find what the catalogue has: materials of blocks, bases and films, and bonds of films."""

from __future__ import annotations

from geometry.common.errors import InputError, describe_choices
from geometry.scenes.bonds import CatalogueBond, find_bond, list_bonds
from geometry.scenes.catalogue import CatalogueMaterial, find_material, list_materials, read_catalogue
from geometry.scenes.recipes import parse_name

Entry = CatalogueMaterial | CatalogueBond


def list_entries() -> dict[str, Entry]:
    """Return all built-in materials and bonds by name."""
    return {**list_materials(), **list_bonds()}


def find_entry(name: str, *, thinner: float | None = None, ratio: float | None = None) -> Entry:
    """Return a built-in material or bond.

    Parameters
    ----------
    name
        As ``list_entries`` has it; a recipe may follow that of a material.
    thinner, ratio
        See ``geometry.scenes.catalogue.find_material``.

    Raises
    ------
    InputError
        Nothing has that name, or no recipe is known with these numbers.
    """
    if name in list_bonds():
        if thinner is not None or ratio is not None:
            raise InputError("material", name, "an elastomer beside --thinner or --ratio: a bond has no recipe")
        return find_bond(name)
    plain = parse_name(name)[0]
    if plain not in read_catalogue():
        raise InputError("material", name, describe_choices(plain, list_entries()))
    return find_material(name, thinner=thinner, ratio=ratio)
