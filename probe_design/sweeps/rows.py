"""Evaluate the designs of a sweep in any process: one row per design; an error becomes a row with its type and reason."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache, lru_cache
from itertools import groupby
from pathlib import Path
from time import perf_counter
from typing import TypeVar

from geometry.common.errors import InputError, Words
from geometry.common.json_types import JsonMapping, JsonObject
from geometry.common.resources import LimitReached, get_limits
from geometry.provenance.block import DISTRIBUTION, compute_file_digest, find_version
from geometry.scenes.keys import Key, Value, find_key, replace_values
from geometry.scenes.scene import Scene
from probe_design.sweeps.file import Sweep, build_scene
from solver import Result, evaluate, evaluators
from solver.batch import evaluate_together
from solver.linalg.memory import give_back
from solver.results.evaluator import OutOfReach
from solver.results.warnings import select_notes

# columns of numbers with their SI units; a column of results is an attribute of ``solver.Result``
RESULT_UNITS = {
    "stress_inner": "Pa", "stress_outer": "Pa", "ratio": "", "log_sensitivity": "", "stiffness": "N/m", "charge_inner": "C",
    "charge_outer": "C", "charge_per_force_inner": "C/N", "charge_per_force_outer": "C/N", "charge_ratio": "",
    "charge_log_sensitivity": "", "equivalent_modulus": "Pa", "error_estimate": "", "charge_ratio_error": "", "residual": "",
}  # fmt: skip
LIMIT_UNITS = {"time_limit": "s", "memory_limit": "byte"}  # the limit that stopped a design, or kept it from a finer result
COLUMN_UNITS = RESULT_UNITS | LIMIT_UNITS | {"seconds": "s"}
ROW_COLUMNS = (
    "status", "type", "reason", *LIMIT_UNITS, "evaluator", "observable", *RESULT_UNITS, "plan", "warnings", "seconds",
)  # fmt: skip
SOURCE_ROOT = Path(__file__).parents[2]  # contains the packages whose sources are hashed
SOURCE_SUFFIXES = {".py", ".npy", ".json"}  # files on which results depend
RESULT_LIBRARIES = ("numpy", "scipy", "rslab", "py-mkl-pardiso", "netgen-mesher", "pytetwild")  # change results in the last bits
MAX_CLOSED_FORM_DESIGNS = 128  # closed-form designs evaluated at once: more are no faster
MAX_CURVE_DESIGNS = 64  # moduli and loads of a design at once: more are hardly faster, and a kill may lose them
# keys whose values the axisymmetric evaluator covers with one curve
CURVE_KEYS = {("inclusion", 0, "youngs_modulus"), ("load", "force"), ("load", "indentation")}
AUTO_EVALUATOR, FORMULA_EVALUATOR = "auto", "closed-form"
Design = tuple[Value, ...]  # values of the variables
Row = JsonObject
T = TypeVar("T")


@dataclass(frozen=True)
class Job:
    """Settings shared by all designs of a sweep.

    Attributes
    ----------
    base
        The tables of the scene that is varied.
    names
        The keys of the variables.
    evaluator, accuracy, linear
        As in ``solver.evaluate``.
    version
        Version of the software that must evaluate the designs; see ``compute_version``.
    """

    base: JsonMapping
    names: tuple[str, ...]
    evaluator: str
    accuracy: float
    linear: bool
    version: str

    @classmethod
    def from_sweep(cls, sweep: Sweep) -> Job:
        """Return the job of a sweep, with the version of this software."""
        names = tuple(variable_key.name for variable_key in sweep.keys)
        return cls(sweep.base, names, sweep.evaluator, sweep.accuracy, sweep.linear, compute_version())

    @property
    def keys(self) -> tuple[Key, ...]:
        """The keys of the variables."""
        return tuple(find_key(name, self.base, Scene) for name in self.names)

    def compute_digest(self, keys: tuple[Key, ...], values: Design) -> bytes:
        """Compute the SHA-256 that identifies one design's result: scene, evaluator, accuracy, ``linear`` and version.

        The scene is hashed as JSON with sorted keys and exact floats; surface files enter with their content, not their
        name.
        """
        scene = replace_values(self.base, keys, values)
        bodies = [_replace_surface_name(body) if body.get("surface") else body for body in scene.get("inclusion", ())]
        return _hash_json([scene | {"inclusion": bodies}, self.evaluator, self.accuracy, self.linear, self.version])

    def group_designs(self, designs: Sequence[Design]) -> list[Hashable]:
        """Return a group key for each design; designs with the same key can be evaluated together.

        The closed form takes arrays of any designs. The finite elements compute all moduli of a single inclusion, and all loads,
        of one probe and tissue from one curve. Other designs have a key of their own.
        """
        if self.evaluator == FORMULA_EVALUATOR:
            return [()] * len(designs)
        if self.evaluator not in ("axisymmetric", AUTO_EVALUATOR) or len(self.base.get("inclusion", ())) > 1:
            return [*range(len(designs))]
        separate_columns = [k for k, variable_key in enumerate(self.keys) if variable_key.path not in CURVE_KEYS]
        groups = [tuple(values[k] for k in separate_columns) for values in designs]
        return [*groups] if len(separate_columns) < len(self.names) else [*range(len(designs))]

    def count_parts(self, designs: Sequence[Design]) -> list[int]:
        """Return the sizes of consecutive parts of ``designs``, each of which is evaluated together."""
        max_designs = MAX_CLOSED_FORM_DESIGNS if self.evaluator == FORMULA_EVALUATOR else MAX_CURVE_DESIGNS
        # lengths of runs of neighbouring designs with the same group key
        runs = [len(list(run)) for _, run in groupby(self.group_designs(designs))]
        return [min(max_designs, run - first) for run in runs for first in range(0, run, max_designs)]

    def warm_up(self) -> None:
        """Import the evaluator and build the scene once, so that the first row's time does not include it.

        Raises
        ------
        InputError
            This software has another version than the job.
        """
        if compute_version() != self.version:
            raise InputError(
                "version", Words(compute_version()), f"{self.version}, on every worker as where the sweep was started"
            )

        _catch_fault(lambda: build_scene(self.base, (), ()))  # the base itself need not be valid
        if self.evaluator == evaluators.AUTO:
            import solver.planning.plan  # noqa: F401
        else:
            evaluators.evaluator(self.evaluator)

    def evaluate_parts(self, designs: Sequence[Design]) -> Iterator[list[Row]]:
        """Evaluate designs part by part; yield the rows of each part, or single rows where a part cannot be evaluated together.

        Linear algebra uses one thread, so that results are the same to the last bit on every machine. Each design has the limits
        ``geometry.common.resources.get_limits``; n designs that are evaluated together have n times its time.
        """
        from solver.linalg.threads import limit_to_one_thread

        keys = self.keys
        first = 0
        try:
            with limit_to_one_thread():
                for count in self.count_parts(designs):
                    yield from self._evaluate_part(keys, designs[first : first + count])
                    first += count
        finally:  # also where no more parts are wanted
            give_back()

    def _evaluate_part(self, keys: tuple[Key, ...], designs: Sequence[Design]) -> Iterator[list[Row]]:
        """Yield the rows of a part: all at once if it can be evaluated together, else one by one."""
        start = perf_counter()
        scenes = [_catch_fault(lambda values=values: build_scene(self.base, keys, values)) for values in designs]  # type: ignore[misc]
        joint_results = self._evaluate_together([scene for scene in scenes if isinstance(scene, Scene)])
        if joint_results is not None:
            results = iter(joint_results)
            outcomes = [next(results) if isinstance(scene, Scene) else scene for scene in scenes]
            seconds = (perf_counter() - start) / len(designs)
            yield [_build_row(scene, seconds) for scene in outcomes]
            return
        for scene in scenes:
            outcome = self._evaluate_alone(scene) if isinstance(scene, Scene) else scene
            yield [_build_row(outcome, perf_counter() - start)]
            start = perf_counter()

    def _evaluate_together(self, scenes: Sequence[Scene]) -> list[Result | Exception] | None:
        """Evaluate several scenes together; return None if that is not possible for all of them."""
        if not scenes:
            return None
        results = _catch_fault(lambda: evaluate_together(scenes, self.evaluator, self.accuracy, linear=self.linear))
        return None if isinstance(results, Exception) or None in results else [result for result in results if result is not None]

    def _evaluate_alone(self, scene: Scene) -> Result | Exception:
        """Return the result of one scene, or the exception that it raised."""
        return _catch_fault(lambda: evaluate(scene, evaluator=self.evaluator, accuracy=self.accuracy, linear=self.linear))


def _catch_fault(compute: Callable[[], T]) -> T | Exception:
    """Return the result of ``compute`` or the exception that it raised, so that the next designs are still evaluated."""
    try:
        return compute()
    except Exception as fault:
        return fault


def _build_row(result: Result | Exception, seconds: float) -> Row:
    """Build the row of a result, or of a design that was refused or failed; ``seconds`` is its computing time."""
    if isinstance(result, Exception):
        status = "refused" if isinstance(result, InputError) else "failed"
        return build_row_without_result(status, type(result).__name__, str(result), seconds) | _find_stopping_limit(result)
    numbers = {name: getattr(result, name) for name in RESULT_UNITS}
    if not all(math.isfinite(number) for number in numbers.values() if number is not None):
        return build_row_without_result("failed", "ArithmeticError", "a result is not finite", seconds)
    details = {"plan": [asdict(decision) for decision in result.plan], "warnings": result.warnings}
    texts = {name: json.dumps(value, allow_nan=False) for name, value in details.items()}
    # a row notes the limits if one of them kept the design from a finer result
    columns = {"status": "ok", "evaluator": result.evaluator, "observable": result.observable, "seconds": seconds}
    return (
        dict.fromkeys(ROW_COLUMNS)
        | columns
        | numbers
        | texts
        | (_read_both_limits() if select_notes(result.warnings, "limit") else {})
    )


def _find_stopping_limit(fault: Exception) -> Row:
    """Return the limits, by column, that stopped a design: with larger ones it may have a result; empty if none did."""
    if isinstance(fault, LimitReached):
        return {"time_limit": get_limits().seconds} if fault.key == "time" else {"memory_limit": get_limits().memory}
    return _read_both_limits() if isinstance(fault, OutOfReach) and fault.stopped else {}


def _read_both_limits() -> Row:
    """Return both limits, by column, for a design that one of them stopped; it is not known which one."""
    return {"time_limit": get_limits().seconds, "memory_limit": get_limits().memory}


def build_row_without_result(status: str, kind: str, reason: str, seconds: float) -> Row:
    """Build the row of a design without a result.

    Parameters
    ----------
    status
        refused or failed.
    kind
        Name of the exception's type, or of a similar cause.
    reason
        In words; stored as one line, shortened if it is long.
    seconds
        Computing time.
    """
    line = " ".join(reason.split())[:2000]
    return dict.fromkeys(ROW_COLUMNS) | {"status": status, "type": kind, "reason": line, "seconds": seconds}


@cache
def compute_version() -> str:
    """Return the software's version, a digest of the sources and data on which results depend, and the versions of libraries."""
    digest = hashlib.sha256()
    for package in ("geometry", "solver"):
        for path in sorted(path for path in (SOURCE_ROOT / package).rglob("*") if path.suffix in SOURCE_SUFFIXES):
            digest.update(path.relative_to(SOURCE_ROOT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    libraries = (f"{name} {find_version(name) or 0}" for name in RESULT_LIBRARIES)
    return " ".join((f"{find_version(DISTRIBUTION) or 0}+{digest.hexdigest()[:12]}", *libraries))


def _hash_json(value: object) -> bytes:
    """Return the SHA-256 of a value as JSON with sorted keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).digest()


def _replace_surface_name(body: JsonMapping) -> JsonObject:
    """Return an inclusion with the digest of its surface file in place of the file name."""
    path = Path(str(body["surface"]))
    try:
        stamp = path.stat()
        content = _digest_surface(path, stamp.st_mtime_ns, stamp.st_size)
    except (OSError, ValueError):
        content = None
    return {**body, "surface": content or f"{path}, which cannot be read"}


_digest_surface = lru_cache(maxsize=64)(lambda path, *_: compute_file_digest(path))  # cached by path, modification time and size
