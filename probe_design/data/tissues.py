"""Built-in tissues: numbers with scatter and source, as tables for a scene file."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from geometry.common.errors import InputError, describe_choices
from geometry.common.json_types import JsonObject
from geometry.scenes.sourced_numbers import Number, format_toml


@dataclass(frozen=True)
class BuiltinTissue:
    """A tissue of one material below up to eight layers.

    Attributes
    ----------
    name, about
        Name and description.
    base
        youngs_modulus and poisson_ratio below the layers.
    layers
        Thickness, youngs_modulus and poisson_ratio of each, from the surface downwards.
    """

    name: str
    about: str
    base: dict[str, Number]
    layers: tuple[dict[str, Number], ...]

    def as_dict(self) -> JsonObject:
        """Return the JSON object of ``probe-design tissue show``: a scene's table, and the source of each number."""
        parts = {"tissue": self.base} | {f"tissue.layer[{k}]": layer for k, layer in enumerate(self.layers)}
        sources = {f"{part}.{key}": number.description for part, numbers in parts.items() for key, number in numbers.items()}
        table = {"shape": "half-space"} | _list_values(self.base) | {"layer": [_list_values(layer) for layer in self.layers]}
        return {"name": self.name, "about": self.about, "tissue": table, "sources": sources}

    def toml(self) -> str:
        """Return the table ``[tissue]`` of a scene file, each number below a comment with its source."""
        shape = ["# no end is assumed; a patient's own: 'cylinder' with radius and depth, or 'block'", 'shape = "half-space"']
        lines = [f"# {self.name}: {self.about}", "[tissue]", *shape, *format_toml(self.base)]
        for layer in self.layers:
            lines += ["", "[[tissue.layer]]", *format_toml(layer)]
        return "\n".join(lines) + "\n"


def find_tissue(name: str) -> BuiltinTissue:
    """Return a built-in tissue.

    Raises
    ------
    InputError
        There is no tissue of that name.
    """
    known_tissues = read_tissues()
    if name not in known_tissues:
        raise InputError("tissue", name, describe_choices(name, known_tissues))
    return known_tissues[name]


@cache
def read_tissues() -> dict[str, BuiltinTissue]:
    """Return all built-in tissues by name."""
    entries = tomllib.loads(files("probe_design.data").joinpath("tissues.toml").read_text(encoding="utf-8"))
    return {
        name: BuiltinTissue(
            name,
            entry["about"],
            _build_numbers(entry["tissue"]),
            tuple(_build_numbers(layer) for layer in entry.get("layer", ())),
        )
        for name, entry in entries.items()
    }


def _build_numbers(entry: JsonObject) -> dict[str, Number]:
    """Return the numbers of a table of ``tissues.toml``, with scatter and source, by their keys."""
    return {key: Number(**number) for key, number in entry.items()}


def _list_values(numbers: dict[str, Number]) -> dict[str, str | float]:
    """Return only the values of numbers, as a scene file has them."""
    return {key: number.value for key, number in numbers.items()}
