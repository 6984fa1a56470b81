"""How exactly parts are made: machining, casting and printing, each with its deviations and their source."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

Table = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Process:
    """A way to make a part; deviations either way, mm.

    Attributes:
        name: in ``processes.toml``, such as "casting".
        about: what it is.
        general: what a title block says of sizes without a deviation.
        source: of the deviations.
        roughness, bonded: of the faces, and of those that are bonded.
        fixed: sizes up to, and their deviations.
        closure: likewise of sizes across the parting plane of a mould; empty: as ``fixed``.
        relative, minimum: deviation over size, and the lowest deviation, beyond the tables; 0 and 0: none there.
        smallest: size below which the tables have none.
        finest, finest_source: the lowest deviations that can be asked for; empty: no tighter ones than the usual.
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

    def deviation(self, size: float, closure: bool = False) -> float | None:
        """Return the usual deviation of a size, mm; None where the source has none."""
        if size < self.smallest:
            return None
        found = _of_table((self.closure if closure else ()) or self.fixed, size)
        beyond = max(self.relative * size, self.minimum)
        return beyond or None if found is None else found

    def tightest(self, size: float) -> float | None:
        """Return the lowest deviation of a size that can be asked for, mm; None where no tighter one than the usual can."""
        found = _of_table(self.finest, size)
        return self.finest[-1][1] * size / self.finest[-1][0] if self.finest and found is None else found


def find_process(name: str) -> Process:
    """Return a process by its name."""
    return _processes()[name]


@cache
def _processes() -> dict[str, Process]:
    entries = tomllib.loads(files("geometry.workshop").joinpath("processes.toml").read_text(encoding="utf-8"))
    return {name: Process(name, **{key: _frozen(value) for key, value in entry.items()}) for name, entry in entries.items()}


def _frozen(value: Any) -> Any:
    return tuple(tuple(row) for row in value) if isinstance(value, list) else value


def _of_table(table: Table, size: float) -> float | None:
    return next((deviation for most, deviation in table if size <= most * (1 + 1e-12)), None)
