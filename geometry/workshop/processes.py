"""Define the deviations of manufacturing processes (machining, casting, printing), with their sources."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

Table = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Process:
    """A manufacturing process; deviations are ±, mm.

    Attributes
    ----------
    name
        Name in ``processes.toml``, such as "casting".
    about
        description.
    general
        Text of the title block on sizes without a deviation.
    source
        Source of the deviations.
    roughness, bonded
        Roughness of the faces, and of faces that are bonded.
    fixed
        Upper limits of size, each with its deviation.
    closure
        The same for sizes across the parting plane of a mould; empty: as ``fixed``.
    relative, minimum
        Deviation over size, and smallest deviation, beyond the tables; 0 and 0: no deviation there.
    smallest
        Size below which the tables have no deviation.
    finest, finest_source
        The smallest deviations that can be ordered, and their source; empty: none below the usual.
    """

    name: str
    about: str
    general: str
    source: str
    roughness: str
    bonded: str
    fixed: Table = ()
    closure: Table = ()
    relative: float = 0.0
    minimum: float = 0.0
    smallest: float = 0.0
    finest: Table = ()
    finest_source: str = ""

    def find_deviation(self, size: float, closure: bool = False) -> float | None:
        """Return the usual deviation of a size, mm; None where the source has none."""
        if size < self.smallest:
            return None
        deviation_found = _look_up((self.closure if closure else ()) or self.fixed, size)
        proportional = max(self.relative * size, self.minimum)
        return proportional or None if deviation_found is None else deviation_found

    def find_tightest(self, size: float) -> float | None:
        """Return the smallest deviation that can be ordered for a size, mm; None if it is the usual one."""
        deviation_found = _look_up(self.finest, size)
        return self.finest[-1][1] * size / self.finest[-1][0] if self.finest and deviation_found is None else deviation_found


def find_process(name: str) -> Process:
    """Return a process by its name."""
    return _read_processes()[name]


@cache
def _read_processes() -> dict[str, Process]:
    entries = tomllib.loads(files("geometry.workshop").joinpath("processes.toml").read_text(encoding="utf-8"))
    return {name: Process(name, **{key: _freeze(value) for key, value in entry.items()}) for name, entry in entries.items()}


def _freeze(value: Any) -> Any:
    return tuple(tuple(row) for row in value) if isinstance(value, list) else value


def _look_up(table: Table, size: float) -> float | None:
    return next((deviation for max_size, deviation in table if size <= max_size * (1 + 1e-12)), None)
