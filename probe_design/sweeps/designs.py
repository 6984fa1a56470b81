"""The variables of a sweep, read from its file, and the designs drawn from them: a grid, or a sample of the unit cube.

A sample is reproducible; it has one column per variable.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words, describe_choices
from geometry.common.json_types import JsonMapping
from geometry.scenes.keys import Key, Value, find_key
from geometry.scenes.scene import Scene

RANDOM_KINDS = ("sobol", "latin-hypercube", "saltelli")
SAMPLE_KINDS = ("grid", *RANDOM_KINDS)
MAX_DESIGNS = 10_000_000  # designs of a sweep
MAX_VALUES = 1_000_000  # of one variable
VARIABLE_KEYS = ("values", "from", "to", "points", "scale")


@dataclass(frozen=True)
class Variable:
    """A variable of a sweep: a key with a list of values, or a range.

    Attributes
    ----------
    key
        Key of the scene that is varied.
    values
        Values of a grid, or those from which a sample draws, each equally likely; empty for a range.
    low, high
        Range of a sample without ``values``; SI.
    log
        Whether the range is uniform in the logarithm.
    """

    key: Key
    values: tuple[Value, ...] = ()
    low: float = 0.0
    high: float = 0.0
    log: bool = False

    def interpolate(self, fraction: float) -> Value:
        """Return the value at a fraction of the range, from 0 to 1."""
        if self.values:
            return self.values[min(int(fraction * len(self.values)), len(self.values) - 1)]
        if self.log:
            return float(self.low * (self.high / self.low) ** fraction)
        return float(self.low + (self.high - self.low) * fraction)


@dataclass(frozen=True)
class DesignSampling:
    """How the designs are drawn.

    Attributes
    ----------
    kind
        One of ``SAMPLE_KINDS``. ``saltelli`` draws n (d + 2) designs of d variables, for Sobol indices.
    n
        Number of points; unused by a grid.
    seed
        Of the random generator.
    """

    kind: str = "grid"
    n: int = 0
    seed: int = 0

    def draw_designs(self, variables: tuple[Variable, ...]) -> list[tuple[Value, ...]]:
        """Return the values of all variables, a tuple for each design; in a grid the last variable changes fastest.

        Raises
        ------
        InputError
            There are too many designs.
        """
        count = self.count_designs(variables)
        if count > MAX_DESIGNS:
            raise InputError("sample", f"{count} designs", f"at most {MAX_DESIGNS}")
        if self.kind == "grid":
            shape = tuple(len(variable.values) for variable in variables)
            grid_indices = np.unravel_index(np.arange(count), shape)
            columns = [
                [variable.values[place] for place in indices.tolist()]
                for variable, indices in zip(variables, grid_indices, strict=True)
            ]
        else:
            points = self._draw_points(len(variables))
            columns = [
                [variable.interpolate(fraction) for fraction in column]
                for variable, column in zip(variables, points.T.tolist(), strict=True)
            ]
        return list(zip(*columns, strict=True))

    def count_designs(self, variables: tuple[Variable, ...]) -> int:
        """Return the number of designs before constraints exclude any."""
        if self.kind == "grid":
            return int(np.prod([float(len(variable.values)) for variable in variables]))  # floats do not overflow
        return self.n * (len(variables) + 2) if self.kind == "saltelli" else self.n

    def _draw_points(self, d: int) -> Floats:
        """Draw points of the unit cube of d variables, shape (designs, d)."""
        from scipy.stats import qmc

        columns = 2 * d if self.kind == "saltelli" else d
        engine = qmc.LatinHypercube(d, rng=self.seed) if self.kind == "latin-hypercube" else qmc.Sobol(columns, rng=self.seed)
        with warnings.catch_warnings():
            # any n is allowed; docs/guides/sweep.md recommends powers of 2
            warnings.simplefilter("ignore", UserWarning)
            points: Floats = engine.random(self.n)
        return _arrange_saltelli(points) if self.kind == "saltelli" else points


def _arrange_saltelli(points: Floats) -> Floats:
    """Return the d + 2 designs of each point (A, B), A and B of d variables, in the order that SALib expects.

    They are A, then A with variable k replaced by that of B, for each k in turn, then B. Shape of ``points`` (n, 2 d), of the
    result (n (d + 2), d).

    Saltelli et al., Computer Physics Communications 181 (2010) 259-270, table 2, radial design.
    """
    d = points.shape[1] // 2
    a, b = points[:, :d], points[:, d:]
    block = np.repeat(a[:, None, :], d + 2, axis=1)
    for k in range(d):
        block[:, k + 1, k] = b[:, k]
    block[:, d + 1] = b
    return block.reshape(-1, d)


def read_variable(name: str, entry: object, base: JsonMapping, *, kind: str, units_required: bool, folder: Path) -> Variable:
    """Read and check one variable.

    Parameters
    ----------
    name
        Its key.
    entry
        A list of its values, or a table with the keys ``VARIABLE_KEYS``.
    base
        The tables of the scene.
    kind
        Kind of the sample; ranges of a grid need ``points``.
    units_required
        Whether a bare number is refused where a unit belongs.
    folder
        To which names of surface files are relative.

    Raises
    ------
    InputError
        A key or value is not allowed.
    """
    scene_key = find_key(name, base, Scene)
    if isinstance(entry, list | tuple | np.ndarray):
        entry = {"values": entry}
    if not isinstance(entry, Mapping):
        raise InputError(name, entry, "a list of values, or a table with from and to")
    for part in entry:
        if part not in VARIABLE_KEYS:
            raise InputError(f"{name}.{part}", entry[part], describe_choices(part, VARIABLE_KEYS))
    if "values" in entry:
        choices = _read_list(scene_key, entry, units_required)
        if scene_key.path[-1] == "surface":
            choices = tuple(str((folder / str(surface)).absolute()) for surface in choices)
        return Variable(scene_key, choices)
    low, high = (_read_bound(scene_key, entry, end, units_required) for end in ("from", "to"))
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
        return Variable(scene_key, (), low, high, scale == "log")
    points = check_integer(f"{name}.points", entry.get("points"), 2, MAX_VALUES)
    values = np.geomspace(low, high, points) if scale == "log" else np.linspace(low, high, points)
    values[0], values[-1] = low, high  # exactly, without rounding
    return Variable(scene_key, tuple(values.tolist()), log=scale == "log")


def _read_list(scene_key: Key, table: Mapping[str, object], units_required: bool) -> tuple[Value, ...]:
    """Return the checked values of a variable given as a list, the only entry of its table."""
    values = table["values"].tolist() if isinstance(table["values"], np.ndarray) else table["values"]
    if not isinstance(values, list | tuple) or not 1 <= len(values) <= MAX_VALUES or len(table) > 1:
        raise InputError(f"{scene_key.name}.values", values, "a list of values, alone")
    checked_values = tuple(_read_value(scene_key, value, f"{scene_key.name}.values", units_required) for value in values)
    if len({type(value) for value in checked_values}) > 1:
        raise InputError(f"{scene_key.name}.values", values, "values of one kind: numbers, texts, or true and false")
    return checked_values


def _read_bound(scene_key: Key, table: Mapping[str, object], end: str, units_required: bool) -> float:
    """Return one end of a range, SI; ``end`` is its key, from or to. Raises ``InputError``."""
    if end not in table:
        raise InputError(f"{scene_key.name}.{end}", Words("missing"), "from and to, or values")
    value = _read_value(scene_key, table[end], f"{scene_key.name}.{end}", units_required)
    if not isinstance(value, float) or not np.isfinite(value):
        raise InputError(
            f"{scene_key.name}.{end}", table[end], "a finite number" + (" with its unit" if scene_key.quantity else "")
        )
    return value


def _read_value(scene_key: Key, value: object, name: str, units_required: bool) -> Value:
    """Return one checked value of a variable, which may be a NumPy scalar; ``name`` is for messages. Raises ``InputError``."""
    return scene_key.read_value(value.item() if isinstance(value, np.generic) else value, name, units_required)


def check_integer(name: str, value: object, low: int, high: int) -> int:
    """Check an integer from ``low`` to ``high`` and return it. Raises ``InputError``."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not low <= value <= high:
        raise InputError(name, Words("missing") if value is None else value, f"a whole number from {low} to {high}")
    return int(value)
