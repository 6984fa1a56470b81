"""Find keys of a scene file such as ``inclusion[0].depth``, read their values, and replace these in a scene's tables."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel

from geometry.common.errors import InputError, Words, describe_choices
from geometry.common.json_types import JsonObject
from geometry.scenes.bonds import BOND_NUMBERS, BOND_SIDES
from geometry.scenes.catalogue import CATALOGUE_NUMBERS
from geometry.scenes.units import Quantity, find_number
from geometry.scenes.validation_messages import list_models

Path = tuple[str | int, ...]
Value = float | str | bool
_KEY_PART_PATTERN = re.compile(r"([a-z][a-z0-9_]*)((?:\[[0-9]{1,4}\])*)")
# pairs of keys of one table that exclude each other: setting one removes the other
_EXCLUSIVE_KEYS = (
    ("area_ratio", "outer_radius"),
    ("height", "inner_height"),
    ("height", "outer_height"),
    ("force", "indentation"),
)


@dataclass(frozen=True)
class Key:
    """One key of a scene file.

    Attributes
    ----------
    name
        As the user wrote it.
    path
        Table names, list indices and the key, from the top of a scene file.
    quantity
        The quantity that its values are; None for keys without a unit.
    """

    name: str
    path: Path
    quantity: Quantity | None

    @property
    def unit(self) -> str:
        """The SI unit of its values; empty if they have none."""
        return self.quantity.si if self.quantity else ""

    @property
    def display_unit(self) -> str:
        """The unit in which its values are displayed; empty if they have none."""
        return self.quantity.unit if self.quantity else ""

    def read_bare_value(self, entry: object) -> Value:
        """Convert a value that Python code gives to SI units.

        Raises
        ------
        InputError
            See ``read_value``; or the number is so large that its unit must be missing.
        """
        if self.quantity is not None:
            try:
                self.quantity.check_bare(entry)
            except ValueError as fault:
                raise InputError(self.name, entry, f"{self.quantity.allowed} ({fault})") from None
        return self.read_value(entry, self.name, units_required=False)

    def read_value(self, entry: object, name: str, units_required: bool) -> Value:
        """Convert an entry to a value in SI units; ``name`` stands in messages.

        Raises
        ------
        InputError
            The entry is not a finite number, text or boolean, its unit does not fit, or a required unit is missing.
        """
        if isinstance(entry, bool) or (isinstance(entry, str) and self.quantity is None):
            return entry
        number = find_number(entry)
        if number is not None and not (units_required and self.quantity):
            if not math.isfinite(number):
                raise InputError(name, entry, "finite numbers")
            return number
        if self.quantity is None:
            raise InputError(name, entry, "a number, a text, true or false")
        return self.quantity.read(name, entry)


def find_key(name: str, base: Mapping[str, object], model: type[BaseModel]) -> Key:
    """Find a key of a scene by its name.

    Parameters
    ----------
    name
        Such as ``probe.gap``, ``inclusion[0].depth``; ``inclusion.depth`` where there is one inclusion.
    base
        The tables of the scene.
    model
        Of the tables, ``geometry.scenes.scene.Scene``.

    Raises
    ------
    InputError
        No scene has such a key, or this scene does not have the table that contains it.
    """
    parts = [_KEY_PART_PATTERN.fullmatch(part) for part in name.split(".")]
    if None in parts:
        raise InputError("variable", name, "keys of the scene file, such as probe.gap or inclusion[0].depth")
    path: list[str | int] = []
    for part in parts:
        assert part is not None
        path += [part[1], *(int(number) for number in re.findall("[0-9]+", part[2]))]
    if path[0] == "inclusion" and len(path) > 1 and isinstance(path[1], str):
        bodies = base.get("inclusion", ())
        count = len(bodies) if isinstance(bodies, list | tuple) else 0
        if count != 1:
            raise InputError("variable", name, f"inclusion[NUMBER].{path[1]}: the scene has {count} inclusions")
        path.insert(1, 0)
    return Key(name, tuple(path), _find_quantity(name, tuple(path), base, model))


def replace_values(base: Mapping[str, object], keys: Iterable[Key], values: Iterable[Value]) -> JsonObject:
    """Return the tables of a scene with new values of ``keys``; ``base`` is not modified.

    A key that excludes a new one is removed; so are the numbers of a material or bond with a new name, and the name of one with a
    new number.
    """
    data, changes = dict(base), list(zip(keys, values, strict=True))
    # all removals come before all new values, so that none of these is removed again
    for target, value in changes:
        *table, last = target.path
        for pair in _EXCLUSIVE_KEYS:
            if last in pair:
                (excluded,) = {*pair} - {last}
                data = _remove_at_path(data, (*table, excluded))
        name, numbers = ("name", BOND_NUMBERS) if table and table[-1] in BOND_SIDES else ("material", CATALOGUE_NUMBERS)
        if last in numbers and find_at_path(base, target.path) != value:
            data = _remove_at_path(data, (*table, name))
        for number in numbers if last == name else ():
            data = _remove_at_path(data, (*table, number))
    for target, value in changes:
        data = _replace_at_path(data, target.path, value)
    return data


def find_at_path(base: Mapping[str, object], path: Path) -> object:
    """Return the entry at a path, or None."""
    place: Any = base
    for part in path:
        try:
            place = place[part]
        except (KeyError, IndexError, TypeError):
            return None
    return place


def _replace_at_path(place: Any, path: Path, value: Value) -> Any:
    """Return a copy with a new value at a path; only the tables along the path are copied."""
    if not path:
        return value
    if isinstance(place, list | tuple):
        copy: Any = list(place)
        copy[path[0]] = _replace_at_path(copy[path[0]], path[1:], value)
        return copy
    copy = dict(place)
    copy[path[0]] = _replace_at_path(copy.get(path[0], {}), path[1:], value)
    return copy


def _remove_at_path(place: Any, path: Path) -> Any:
    """Return a copy without the entry at a path, if there is one; only the tables along the path are copied."""
    first, *inner_path = path
    if isinstance(place, list | tuple):
        return [_remove_at_path(item, tuple(inner_path)) if k == first else item for k, item in enumerate(place)]
    if not inner_path:
        return {key: value for key, value in place.items() if key != first}
    return {**place, first: _remove_at_path(place[first], tuple(inner_path))} if first in place else place


def _find_quantity(name: str, path: Path, base: Mapping[str, object], model: type[BaseModel]) -> Quantity | None:
    """Return the quantity of the key at a path, from the annotations of the pydantic models."""
    kind: object = model
    for depth, part in enumerate(path):
        models = list_models(kind)
        if isinstance(part, int):
            entries = find_at_path(base, path[:depth])
            if not isinstance(entries, list | tuple) or part >= len(entries):
                count = len(entries) if isinstance(entries, list | tuple) else 0
                raise InputError("variable", name, f"a number in brackets below {count}, as many as the scene has")
            kind = get_args(kind)[0] if get_args(kind) else kind
            continue
        fields = {key: field for model in models for key, field in model.model_fields.items()}
        if part not in fields:
            allowed = f"in place of {part} {describe_choices(part, fields)}" if fields else "a key of the scene file"
            raise InputError("variable", name, allowed)
        field = fields[part]
        kind = field.annotation
        quantities = [note for note in field.metadata if isinstance(note, Quantity)] or _list_quantities(kind)
    if list_models(kind):
        raise InputError("variable", name, Words("a key with one value, not a table"))
    return quantities[0] if quantities else None


def _list_quantities(kind: object) -> list[Quantity]:
    """Return the quantities in a type annotation."""
    quantities = [note for note in getattr(kind, "__metadata__", ()) if isinstance(note, Quantity)]
    arguments = get_args(kind) if get_origin(kind) is not None or isinstance(kind, type(Union[int, str])) else ()  # noqa: UP007
    return quantities + [note for argument in arguments for note in _list_quantities(argument)]
