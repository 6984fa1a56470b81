"""Read the variables of a sweep from the tables of its file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from geometry.common.errors import InputError, Words, one_of
from probe_design.sweeps.keys import Key, Value, key
from probe_design.sweeps.samples import Variable

MOST_VALUES = 1_000_000  # of one variable
PARTS = ("values", "from", "to", "points", "scale")


def variable(name: str, entry: object, base: Mapping[str, Any], *, kind: str, units_required: bool, folder: Path) -> Variable:
    """Read and check one variable.

    Args:
        name: its key.
        entry: its values, or a table.
        base: the tables of the scene.
        kind: of the sample; ranges of a grid need ``points``.
        units_required: whether a bare number is refused where a unit belongs.
        folder: to which names of surface files are relative.

    Raises:
        InputError: a key or value is not allowed.
    """
    where = key(name, base)
    if isinstance(entry, list | tuple | np.ndarray):
        entry = {"values": entry}
    if not isinstance(entry, Mapping):
        raise InputError(name, entry, "a list of values, or a table with from and to")
    for part in entry:
        if part not in PARTS:
            raise InputError(f"{name}.{part}", entry[part], one_of(part, PARTS))
    if "values" in entry:
        listed = _listed(where, entry, units_required)
        if where.path[-1] == "surface":
            listed = tuple(str((folder / str(one)).absolute()) for one in listed)
        return Variable(where, listed)
    low, high = (_bound(where, entry, end, units_required) for end in ("from", "to"))
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
        return Variable(where, (), low, high, scale == "log")
    points = whole(f"{name}.points", entry.get("points"), 2, MOST_VALUES)
    values = np.geomspace(low, high, points) if scale == "log" else np.linspace(low, high, points)
    values[0], values[-1] = low, high
    return Variable(where, tuple(values.tolist()), log=scale == "log")


def _listed(where: Key, table: Mapping[str, Any], units_required: bool) -> tuple[Value, ...]:
    """Read a list of values."""
    values = table["values"].tolist() if isinstance(table["values"], np.ndarray) else table["values"]
    if not isinstance(values, list | tuple) or not 1 <= len(values) <= MOST_VALUES or len(table) > 1:
        raise InputError(f"{where.name}.values", values, "a list of values, alone")
    checked = tuple(_one(where, value, f"{where.name}.values", units_required) for value in values)
    if len({type(value) for value in checked}) > 1:
        raise InputError(f"{where.name}.values", values, "values of one kind: numbers, texts, or true and false")
    return checked


def _bound(where: Key, table: Mapping[str, Any], end: str, units_required: bool) -> float:
    """Read one end of a range."""
    if end not in table:
        raise InputError(f"{where.name}.{end}", Words("missing"), "from and to, or values")
    value = _one(where, table[end], f"{where.name}.{end}", units_required)
    if not isinstance(value, float) or not np.isfinite(value):
        raise InputError(f"{where.name}.{end}", table[end], "a finite number" + (" with its unit" if where.quantity else ""))
    return value


def _one(where: Key, value: object, name: str, units_required: bool) -> Value:
    return where.value(value.item() if isinstance(value, np.generic) else value, name, units_required)


def whole(name: str, value: object, low: int, high: int) -> int:
    """Check an integer from ``low`` to ``high`` and return it. Raises ``InputError``."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not low <= value <= high:
        raise InputError(name, Words("missing") if value is None else value, f"a whole number from {low} to {high}")
    return int(value)
