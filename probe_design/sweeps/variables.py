"""Read the variables of a sweep from the tables of its file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from geometry.common.errors import InputError, Words, describe_choices
from geometry.common.json_types import JsonMapping
from geometry.scenes.keys import Key, Value, find_key
from geometry.scenes.scene import Scene
from probe_design.sweeps.samples import Variable

MAX_VALUES = 1_000_000  # of one variable
VARIABLE_KEYS = ("values", "from", "to", "points", "scale")


def read_variable(name: str, entry: object, base: JsonMapping, *, kind: str, units_required: bool, folder: Path) -> Variable:
    """Read and check one variable.

    Parameters
    ----------
    name
        Its key.
    entry
        Its values, or a table.
    base
        The tables of the scene.
    kind
        Of the sample; ranges of a grid need ``points``.
    units_required
        Whether a bare number is refused where a unit belongs.
    folder
        To which names of surface files are relative.

    Raises
    ------
    InputError
        A key or value is not allowed.
    """
    target = find_key(name, base, Scene)
    if isinstance(entry, list | tuple | np.ndarray):
        entry = {"values": entry}
    if not isinstance(entry, Mapping):
        raise InputError(name, entry, "a list of values, or a table with from and to")
    for part in entry:
        if part not in VARIABLE_KEYS:
            raise InputError(f"{name}.{part}", entry[part], describe_choices(part, VARIABLE_KEYS))
    if "values" in entry:
        choices = _read_list(target, entry, units_required)
        if target.path[-1] == "surface":
            choices = tuple(str((folder / str(surface)).absolute()) for surface in choices)
        return Variable(target, choices)
    low, high = (_read_bound(target, entry, end, units_required) for end in ("from", "to"))
    scale = entry.get("scale", "linear")
    if scale not in ("linear", "log"):
        raise InputError(f"{name}.scale", scale, "'linear' or 'log'")
    if not np.isfinite(high - low):
        raise InputError(f"{name}.to", entry["to"], "ranges narrower than 1.7e308")
    if not low < high or (scale == "log" and low <= 0):
        raise InputError(
            f"{name}.to", entry["to"], f"more than from = {entry['from']!r}" + (", both above 0" if scale == "log" else "")
        )
    if kind != "grid":
        if "points" in entry:
            raise InputError(f"{name}.points", entry["points"], "none except in a grid: sample.n is the number of points")
        return Variable(target, (), low, high, scale == "log")
    points = check_integer(f"{name}.points", entry.get("points"), 2, MAX_VALUES)
    values = np.geomspace(low, high, points) if scale == "log" else np.linspace(low, high, points)
    values[0], values[-1] = low, high
    return Variable(target, tuple(values.tolist()), log=scale == "log")


def _read_list(target: Key, table: Mapping[str, object], units_required: bool) -> tuple[Value, ...]:
    """Read a list of values."""
    values = table["values"].tolist() if isinstance(table["values"], np.ndarray) else table["values"]
    if not isinstance(values, list | tuple) or not 1 <= len(values) <= MAX_VALUES or len(table) > 1:
        raise InputError(f"{target.name}.values", values, "a list of values, alone")
    checked_values = tuple(_read_value(target, value, f"{target.name}.values", units_required) for value in values)
    if len({type(value) for value in checked_values}) > 1:
        raise InputError(f"{target.name}.values", values, "values of one kind: numbers, texts, or true and false")
    return checked_values


def _read_bound(target: Key, table: Mapping[str, object], end: str, units_required: bool) -> float:
    """Read one end of a range."""
    if end not in table:
        raise InputError(f"{target.name}.{end}", Words("missing"), "from and to, or values")
    value = _read_value(target, table[end], f"{target.name}.{end}", units_required)
    if not isinstance(value, float) or not np.isfinite(value):
        raise InputError(f"{target.name}.{end}", table[end], "a finite number" + (" with its unit" if target.quantity else ""))
    return value


def _read_value(target: Key, value: object, name: str, units_required: bool) -> Value:
    return target.read_value(value.item() if isinstance(value, np.generic) else value, name, units_required)


def check_integer(name: str, value: object, low: int, high: int) -> int:
    """Check an integer from ``low`` to ``high`` and return it. Raises ``InputError``."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not low <= value <= high:
        raise InputError(name, Words("missing") if value is None else value, f"a whole number from {low} to {high}")
    return int(value)
