"""One design in, one row out, in whatever process; every fault becomes a row with its type and reason."""

from __future__ import annotations

import hashlib
import json
import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from time import perf_counter
from typing import Any

from geometry.errors import InputError, Words
from probe_design.sweep_file import Sweep, scene_of
from probe_design.sweep_keys import Key, Value, changed, key

OUTPUTS = (
    "stress_inner", "stress_outer", "ratio", "log_sensitivity", "stiffness", "charge_inner", "charge_outer",
    "equivalent_modulus", "error_estimate",
)  # fmt: skip
COLUMNS = ("status", "type", "reason", "evaluator", *OUTPUTS, "plan", "warnings", "seconds")
Row = dict[str, Any]
_ALONE = threading.Lock()  # solvers hold caches that two threads must not share


@dataclass(frozen=True)
class Job:
    """What all designs of a sweep share.

    Attributes:
        base: the tables of the scene that is varied.
        names: the keys of the variables.
        evaluator, accuracy: as in ``solver.evaluate``.
        version: of the software that is to answer; see ``version``.
    """

    base: Mapping[str, Any]
    names: tuple[str, ...]
    evaluator: str
    accuracy: float
    version: str

    @classmethod
    def of(cls, sweep: Sweep) -> Job:
        """Return the job of a sweep, for this software."""
        names = tuple(one.name for one in sweep.keys)
        return cls(sweep.base, names, sweep.evaluator, sweep.accuracy, version())

    @property
    def keys(self) -> tuple[Key, ...]:
        """The keys of the variables."""
        return tuple(key(name, self.base) for name in self.names)

    def digest(self, keys: tuple[Key, ...], values: tuple[Value, ...]) -> bytes:
        """Return the SHA-256 of one design's scene, of evaluator, accuracy and version.

        The scene stands for itself as JSON with sorted keys, floats written so that they read back the same; of surface files
        the content counts.
        """
        scene = changed(self.base, keys, values)
        surfaces = [_content(str(body.get("surface"))) for body in scene.get("inclusion", ()) if body.get("surface")]
        return _digest([scene, surfaces, self.evaluator, self.accuracy, self.version])

    def rows(self, designs: Sequence[tuple[Value, ...]]) -> list[Row]:
        """Answer designs one after the other, with one thread for linear algebra, so that the bits are the same everywhere.

        Raises:
            InputError: this software is not that of the job.
        """
        from solver.threads import one_thread

        if version() != self.version:
            raise InputError("version", Words(version()), f"{self.version}, on every worker as where the sweep was started")
        keys = self.keys
        with _ALONE, one_thread():
            return [self._row(keys, values) for values in designs]

    def _row(self, keys: tuple[Key, ...], values: tuple[Value, ...]) -> Row:
        from solver import evaluate

        start = perf_counter()
        try:
            found = evaluate(scene_of(self.base, keys, values), self.evaluator, self.accuracy).as_dict()
        except InputError as fault:
            return blank("refused", fault, perf_counter() - start)
        except Exception as fault:  # whatever one design does, the next ones are answered
            return blank("failed", fault, perf_counter() - start)
        row: Row = dict.fromkeys(COLUMNS) | {name: found[name] for name in OUTPUTS}
        numbers = (row[name] for name in OUTPUTS)
        if not all(math.isfinite(number) for number in numbers if number is not None):
            return blank("failed", ArithmeticError("a result is not finite"), perf_counter() - start)
        row |= {"status": "ok", "evaluator": found["evaluator"], "seconds": perf_counter() - start}
        return row | {name: json.dumps(found[name], allow_nan=False) for name in ("plan", "warnings")}


def blank(status: str, fault: BaseException | str, seconds: float) -> Row:
    """Return the row of a design that has no answer."""
    kind = "WorkerDied" if isinstance(fault, str) else type(fault).__name__
    reason = " ".join(str(fault).split())[:2000]
    return dict.fromkeys(COLUMNS) | {"status": status, "type": kind, "reason": reason, "seconds": seconds}


@cache
def version() -> str:
    """Return the version of the software, a digest of the sources that results depend on, the versions of NumPy and SciPy."""
    digest = hashlib.sha256()
    for package in ("geometry", "solver"):
        for path in sorted((Path(__file__).parents[1] / package).glob("*.py")):
            digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    numbers = (metadata.version(name) for name in ("numpy", "scipy"))
    return f"{_own_version()}+{digest.hexdigest()[:12]} numpy {' scipy '.join(numbers)}"


def _own_version() -> str:
    try:
        return metadata.version("probe-design")
    except metadata.PackageNotFoundError:  # run from its folder
        return "0"


def _digest(value: object) -> bytes:
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).digest()


@cache
def _content(name: str) -> str:
    try:
        return hashlib.sha256(Path(name).read_bytes()).hexdigest()
    except OSError:
        return "missing"
