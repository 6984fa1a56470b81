"""One design in, one row out, in whatever process; every fault becomes a row with its type and reason."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache, lru_cache
from importlib import metadata
from itertools import groupby
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, TypeVar

from geometry.common.errors import InputError, Words
from geometry.common.resources import LimitReached, limits
from geometry.provenance.digest import file_digest
from geometry.scenes.scene import Scene
from probe_design.sweeps.file import Sweep, scene_of
from probe_design.sweeps.keys import Key, Value, changed, key

if TYPE_CHECKING:
    from solver import Result

OUTPUTS = (
    "stress_inner", "stress_outer", "ratio", "log_sensitivity", "stiffness", "charge_inner", "charge_outer",
    "equivalent_modulus", "error_estimate", "residual",
)  # fmt: skip
LIMITS = ("time_limit", "memory_limit")  # s and bytes, of a row that this limit stopped, or kept from a finer answer
REAL = (*OUTPUTS, *LIMITS, "seconds")
COLUMNS = ("status", "type", "reason", *LIMITS, "evaluator", *OUTPUTS, "plan", "warnings", "seconds")
ROOT = Path(__file__).parents[2]
SOURCES = {".py", ".npy", ".json"}  # that results depend on
LIBRARIES = ("numpy", "scipy", "rslab", "py-mkl-pardiso", "netgen-mesher", "pytetwild")  # likewise, to the last bit
PIECE = 128  # closed-form designs at once: more are no faster
MODULI = 64  # moduli and loads of a design at once: more are hardly faster, and a kill may cost them
CURVE = {("inclusion", 0, "youngs_modulus"), ("load", "force"), ("load", "indentation")}  # keys that one curve answers
AUTO = "auto"
Row = dict[str, Any]
T = TypeVar("T")


@dataclass(frozen=True)
class Job:
    """What all designs of a sweep share.

    Attributes:
        base: the tables of the scene that is varied.
        names: the keys of the variables.
        evaluator, accuracy, linear: as in ``solver.evaluate``.
        version: of the software that is to answer; see ``version``.
    """

    base: Mapping[str, Any]
    names: tuple[str, ...]
    evaluator: str
    accuracy: float
    linear: bool
    version: str

    @classmethod
    def of(cls, sweep: Sweep) -> Job:
        """Return the job of a sweep, for this software."""
        names = tuple(one.name for one in sweep.keys)
        return cls(sweep.base, names, sweep.evaluator, sweep.accuracy, sweep.linear, version())

    @property
    def keys(self) -> tuple[Key, ...]:
        """The keys of the variables."""
        return tuple(key(name, self.base) for name in self.names)

    def digest(self, keys: tuple[Key, ...], values: tuple[Value, ...]) -> bytes:
        """Return the SHA-256 of one design's scene, of evaluator, accuracy, ``linear`` and version.

        The scene stands for itself as JSON with sorted keys, floats written so that they read back the same; surface files
        count by what they hold, not by their name.
        """
        scene = changed(self.base, keys, values)
        bodies = [_with_content(body) if body.get("surface") else body for body in scene.get("inclusion", ())]
        return _digest([scene | {"inclusion": bodies}, self.evaluator, self.accuracy, self.linear, self.version])

    def alike(self, designs: Sequence[tuple[Value, ...]]) -> list[Hashable]:
        """Return for each design what those that are answered at once share; nothing where each is answered by itself.

        Formulas take arrays of any designs; finite elements answer all moduli of the one inclusion, and all loads, of a probe on
        its tissue by one curve.
        """
        if self.evaluator == "closed-form":
            return [()] * len(designs)
        if self.evaluator not in ("axisymmetric", AUTO) or len(self.base.get("inclusion", ())) > 1:
            return [*range(len(designs))]
        own = [k for k, one in enumerate(self.keys) if one.path not in CURVE]
        every = [tuple(values[k] for k in own) for values in designs]
        return [*every] if len(own) < len(self.names) else [*range(len(designs))]

    def parts(self, designs: Sequence[tuple[Value, ...]]) -> list[int]:
        """Return how many designs, one after the other, are answered at once each time."""
        most = PIECE if self.evaluator == "closed-form" else MODULI
        runs = [len(list(run)) for _, run in groupby(self.alike(designs))]
        return [min(most, run - first) for run in runs for first in range(0, run, most)]

    def load(self) -> None:
        """Import what answers and build the scene once, so that it is no part of the first row's cost."""
        from solver import levels

        _caught(lambda: scene_of(self.base, (), ()))
        if self.evaluator == levels.AUTO:
            import solver.planning.plan
        elif self.evaluator == "closed-form":
            import solver.closed_form.level  # noqa: F401
        else:
            levels.evaluator(self.evaluator)

    def pieces(self, designs: Sequence[tuple[Value, ...]]) -> Iterator[list[Row]]:
        """Answer designs, ``parts`` at a time, with one thread for linear algebra, so that the bits are the same everywhere.

        A part of which not all can be answered together is answered one by one. Each design may take what
        ``geometry.common.resources.limits`` says; those that are answered together have their number of times.

        Raises:
            InputError: this software is not that of the job.
        """
        from solver.linalg.threads import one_thread

        if version() != self.version:
            raise InputError("version", Words(version()), f"{self.version}, on every worker as where the sweep was started")
        keys = self.keys
        with one_thread():
            first = 0
            for count in self.parts(designs):
                yield from self._answered(keys, designs[first : first + count])
                first += count

    def _answered(self, keys: tuple[Key, ...], designs: Sequence[tuple[Value, ...]]) -> Iterator[list[Row]]:
        start = perf_counter()
        built = [_caught(lambda values=values: scene_of(self.base, keys, values)) for values in designs]  # type: ignore[misc]
        together = self._together([one for one in built if isinstance(one, Scene)])
        if together is not None:
            results = iter(together)
            answers = [next(results) if isinstance(one, Scene) else one for one in built]
            seconds = (perf_counter() - start) / len(designs)
            yield [_row(one, seconds) for one in answers]
            return
        for one in built:
            answer = self._alone(one) if isinstance(one, Scene) else one
            yield [_row(answer, perf_counter() - start)]
            start = perf_counter()

    def _together(self, scenes: Sequence[Scene]) -> list[Result | Exception] | None:
        """Answers to several scenes at once; None where that is not possible for all of them."""
        from solver.many import together

        if not scenes:
            return None
        found = _caught(lambda: together(scenes, self.evaluator, self.accuracy, linear=self.linear))
        return None if isinstance(found, Exception) or None in found else [one for one in found if one is not None]

    def _alone(self, scene: Scene) -> Result | Exception:
        from solver import evaluate

        return _caught(lambda: evaluate(scene, evaluator=self.evaluator, accuracy=self.accuracy, linear=self.linear))


def _caught(made: Callable[[], T]) -> T | Exception:
    """What is made, or the fault: whatever one design does, the next ones are answered."""
    try:
        return made()
    except Exception as fault:
        return fault


def _row(result: Result | Exception, seconds: float) -> Row:
    """The row of a result, or of a design that was refused or failed."""
    from solver.results.warnings import of_kind

    if isinstance(result, Exception):
        status = "refused" if isinstance(result, InputError) else "failed"
        return blank(status, type(result).__name__, str(result), seconds) | _stopped(result)
    numbers = {name: getattr(result, name) for name in OUTPUTS}
    if not all(math.isfinite(number) for number in numbers.values() if number is not None):
        return blank("failed", "ArithmeticError", "a result is not finite", seconds)
    details = {"plan": [asdict(one) for one in result.plan], "warnings": result.warnings}
    texts = {name: json.dumps(value, allow_nan=False) for name, value in details.items()}
    found = {"status": "ok", "evaluator": result.evaluator, "seconds": seconds} | numbers | texts
    return dict.fromkeys(COLUMNS) | found | (_either() if of_kind(result.warnings, "limit") else {})


def _stopped(fault: Exception) -> Row:
    """The limits without which a design may have an answer."""
    from solver.results.evaluator import OutOfReach

    if isinstance(fault, LimitReached):
        return {"time_limit": limits().seconds} if fault.key == "time" else {"memory_limit": limits().memory}
    return _either() if isinstance(fault, OutOfReach) and fault.stopped else {}


def _either() -> Row:
    """Both limits, where it is not told which of them stopped a design."""
    return {"time_limit": limits().seconds, "memory_limit": limits().memory}


def blank(status: str, kind: str, reason: str, seconds: float) -> Row:
    """Return the row of a design that has no answer."""
    line = " ".join(reason.split())[:2000]
    return dict.fromkeys(COLUMNS) | {"status": status, "type": kind, "reason": line, "seconds": seconds}


@cache
def version() -> str:
    """Return the software's version, a digest of the sources and data that results depend on, and the versions of libraries."""
    digest = hashlib.sha256()
    for package in ("geometry", "solver"):
        for path in sorted(path for path in (ROOT / package).rglob("*") if path.suffix in SOURCES):
            digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    libraries = (f"{name} {_version_of(name)}" for name in LIBRARIES)
    return " ".join((f"{_version_of('probe-design')}+{digest.hexdigest()[:12]}", *libraries))


def _version_of(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:  # not installed, or run from its folder
        return "0"


def _digest(value: object) -> bytes:
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).digest()


def _with_content(body: Mapping[str, Any]) -> dict[str, Any]:
    """An inclusion with a digest of its surface file in place of the name."""
    path = Path(str(body["surface"]))
    try:
        stamp = path.stat()
        content = _content(path, stamp.st_mtime_ns, stamp.st_size)
    except (OSError, ValueError):
        content = None
    return {**body, "surface": content or f"{path}, which cannot be read"}


_content = lru_cache(maxsize=64)(lambda path, *_: file_digest(path))  # by when it was changed, and its size
