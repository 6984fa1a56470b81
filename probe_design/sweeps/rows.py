"""Evaluate the designs of a sweep in any process: one row per design; an error becomes a row with its type and reason."""

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
LIMITS = ("time_limit", "memory_limit")  # s and bytes: the limit that stopped a design, or kept it from a finer result
REAL = (*OUTPUTS, *LIMITS, "seconds")
COLUMNS = ("status", "type", "reason", *LIMITS, "evaluator", *OUTPUTS, "plan", "warnings", "seconds")
ROOT = Path(__file__).parents[2]  # contains the packages whose sources are hashed
SOURCES = {".py", ".npy", ".json"}  # files on which results depend
LIBRARIES = ("numpy", "scipy", "rslab", "py-mkl-pardiso", "netgen-mesher", "pytetwild")  # change results in the last bits
PIECE = 128  # closed-form designs evaluated at once: more are no faster
MODULI = 64  # moduli and loads of a design at once: more are hardly faster, and a kill may lose them
# keys whose values the axisymmetric evaluator covers with one curve
CURVE = {("inclusion", 0, "youngs_modulus"), ("load", "force"), ("load", "indentation")}
AUTO = "auto"
Row = dict[str, Any]
T = TypeVar("T")


@dataclass(frozen=True)
class Job:
    """Settings shared by all designs of a sweep.

    Attributes:
        base: the tables of the scene that is varied.
        names: the keys of the variables.
        evaluator, accuracy, linear: as in ``solver.evaluate``.
        version: of the software that must evaluate them; see ``compute_version``.
    """

    base: Mapping[str, Any]
    names: tuple[str, ...]
    evaluator: str
    accuracy: float
    linear: bool
    version: str

    @classmethod
    def of(cls, sweep: Sweep) -> Job:
        """Return the job of a sweep, with the version of this software."""
        names = tuple(one.name for one in sweep.keys)
        return cls(sweep.base, names, sweep.evaluator, sweep.accuracy, sweep.linear, version())

    @property
    def keys(self) -> tuple[Key, ...]:
        """The keys of the variables."""
        return tuple(key(name, self.base) for name in self.names)

    def digest(self, keys: tuple[Key, ...], values: tuple[Value, ...]) -> bytes:
        """Compute the SHA-256 that identifies one design's result: scene, evaluator, accuracy, ``linear`` and version.

        The scene is hashed as JSON with sorted keys and exact floats; surface files enter with their content, not their
        name.
        """
        scene = changed(self.base, keys, values)
        bodies = [_with_content(body) if body.get("surface") else body for body in scene.get("inclusion", ())]
        return _digest([scene | {"inclusion": bodies}, self.evaluator, self.accuracy, self.linear, self.version])

    def alike(self, designs: Sequence[tuple[Value, ...]]) -> list[Hashable]:
        """Return a group key for each design; designs with the same key can be evaluated together.

        The closed form takes arrays of any designs. The finite elements compute all moduli of a single inclusion, and all loads,
        of one probe and tissue from one curve. Other designs have a key of their own.
        """
        if self.evaluator == "closed-form":
            return [()] * len(designs)
        if self.evaluator not in ("axisymmetric", AUTO) or len(self.base.get("inclusion", ())) > 1:
            return [*range(len(designs))]
        own = [k for k, one in enumerate(self.keys) if one.path not in CURVE]
        every = [tuple(values[k] for k in own) for values in designs]
        return [*every] if len(own) < len(self.names) else [*range(len(designs))]

    def parts(self, designs: Sequence[tuple[Value, ...]]) -> list[int]:
        """Return the sizes of consecutive parts of ``designs`` that are evaluated together."""
        most = PIECE if self.evaluator == "closed-form" else MODULI
        runs = [len(list(run)) for _, run in groupby(self.alike(designs))]
        return [min(most, run - first) for run in runs for first in range(0, run, most)]

    def load(self) -> None:
        """Import the evaluator and build the scene once, so that the first row is not charged for it."""
        from solver import levels

        _caught(lambda: scene_of(self.base, (), ()))
        if self.evaluator == levels.AUTO:
            import solver.planning.plan
        elif self.evaluator == "closed-form":
            import solver.closed_form.level  # noqa: F401
        else:
            levels.evaluator(self.evaluator)

    def pieces(self, designs: Sequence[tuple[Value, ...]]) -> Iterator[list[Row]]:
        """Evaluate designs part by part; yield the rows of each part, or single rows where a part cannot be evaluated together.

        Linear algebra uses one thread, so that results are the same to the last bit on every machine. Each design has the limits
        ``geometry.common.resources.limits``; n designs that are evaluated together have n times its time.

        Raises:
            InputError: this software has another version than the job.
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
        """Evaluate a part: together if possible, else one by one."""
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
        """Evaluate several scenes together; return None if that is not possible for all of them."""
        from solver.many import together

        if not scenes:
            return None
        found = _caught(lambda: together(scenes, self.evaluator, self.accuracy, linear=self.linear))
        return None if isinstance(found, Exception) or None in found else [one for one in found if one is not None]

    def _alone(self, scene: Scene) -> Result | Exception:
        from solver import evaluate

        return _caught(lambda: evaluate(scene, evaluator=self.evaluator, accuracy=self.accuracy, linear=self.linear))


def _caught(made: Callable[[], T]) -> T | Exception:
    """Return the result of ``compute`` or the exception that it raised, so that the next designs are still evaluated."""
    try:
        return made()
    except Exception as fault:
        return fault


def _row(result: Result | Exception, seconds: float) -> Row:
    """Build the row of a result, or of a design that was refused or failed."""
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
    """Return the limits that stopped a design: with larger ones it may have a result."""
    from solver.results.evaluator import OutOfReach

    if isinstance(fault, LimitReached):
        return {"time_limit": limits().seconds} if fault.key == "time" else {"memory_limit": limits().memory}
    return _either() if isinstance(fault, OutOfReach) and fault.stopped else {}


def _either() -> Row:
    """Return both limits, for a design of which it is not known which one stopped it."""
    return {"time_limit": limits().seconds, "memory_limit": limits().memory}


def blank(status: str, kind: str, reason: str, seconds: float) -> Row:
    """Build the row of a design without a result."""
    line = " ".join(reason.split())[:2000]
    return dict.fromkeys(COLUMNS) | {"status": status, "type": kind, "reason": line, "seconds": seconds}


@cache
def version() -> str:
    """Return the software's version, a digest of the sources and data on which results depend, and the versions of libraries."""
    digest = hashlib.sha256()
    for package in ("geometry", "solver"):
        for path in sorted(path for path in (ROOT / package).rglob("*") if path.suffix in SOURCES):
            digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    libraries = (f"{name} {_version_of(name)}" for name in LIBRARIES)
    return " ".join((f"{_version_of('probe-design')}+{digest.hexdigest()[:12]}", *libraries))


def _version_of(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:  # not installed, or run from its source folder
        return "0"


def _digest(value: object) -> bytes:
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).digest()


def _with_content(body: Mapping[str, Any]) -> dict[str, Any]:
    """Return an inclusion with the digest of its surface file in place of the file name."""
    path = Path(str(body["surface"]))
    try:
        stamp = path.stat()
        content = _content(path, stamp.st_mtime_ns, stamp.st_size)
    except (OSError, ValueError):
        content = None
    return {**body, "surface": content or f"{path}, which cannot be read"}


_content = lru_cache(maxsize=64)(lambda path, *_: file_digest(path))  # cached by path, modification time and size
