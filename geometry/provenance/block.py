"""Build the provenance block, which records the origin of numbers.

The block is a plain dictionary: ``format`` and ``version`` of the block itself, ``program`` and ``dependencies`` (versions),
``scene`` (its digest), ``evaluator``, ``accuracy``, ``seed``, ``command`` (the words after the
program's name, None in Python) and ``inputs`` (SHA-256 of the files that these words name). It contains no absolute path: such a
path in the command is replaced by its last name.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.common.errors import InputError
from geometry.common.json_types import JsonObject
from geometry.scenes.scene_file import read_scene

if TYPE_CHECKING:
    from geometry.scenes.scene import Scene

DISTRIBUTION = "palpation-probe-design"  # of pyproject.toml; PyPI has another program called probe-design
DIGEST_DIGITS = 9  # significant digits of a number: smaller differences leave the digest unchanged
MAX_DIGEST_BYTES = 4_000_000_000  # bytes: read in some seconds; larger files get no digest
BLOCK_FORMAT, BLOCK_VERSION = "probe-design provenance", 1
DEPENDENCIES = (
    "numpy",
    "scipy",
    "casadi",
    "pydantic",
    "netgen-mesher",
    "pytetwild",
    "pyvista",
    "cadquery",
)  # for numbers, shapes
Provenance = JsonObject
# an absolute path, as a word or after "-o", "=", "," or a space: the part before its last name, if it has one
_FROM_ROOT = re.compile(r"(^-[a-zA-Z]|^|(?<=[=,\s]))(?:[A-Za-z]:)?[\\/](?:[^\\/,=]*[\\/])*(?=[^\\/,=\s])")


@dataclass(frozen=True)
class Request:
    """A command line: its words, the files that they name, and the settings that a block lists separately."""

    words: list[str]
    inputs: dict[str, str]
    scene: Scene | Path | None
    settings: dict[str, object]


NO_REQUEST = Request([], {}, None, {})
_request: ContextVar[Request | None] = ContextVar("asked", default=None)


@contextmanager
def record_command(words: Sequence[str], scene: Path | None = None, **settings: object) -> Iterator[None]:
    """Record a command line in the provenance of everything made inside the block.

    Parameters
    ----------
    words
        The words after the program's name; the files that they name are read at once, for their digests.
    scene
        The scene's file, if there is one.
    settings
        ``evaluator``, ``accuracy`` and ``seed``, if they are requested.
    """
    digests = {
        file_name: compute_file_digest(Path(file_name)) for word in words for file_name in (word, *re.split("[=,]", word)[:2])
    }
    inputs = {_remove_folders(name): sha for name, sha in digests.items() if sha is not None}
    token = _request.set(Request([_remove_folders(word) for word in words], inputs, scene, settings))
    try:
        yield
    finally:
        _request.reset(token)


@contextmanager
def record_scene(scene: Scene) -> Iterator[None]:
    """Record a scene in the provenance of everything made inside the block, unless a command line names one."""
    request = _request.get() or NO_REQUEST
    token = _request.set(request if request.scene else replace(request, scene=scene))
    try:
        yield
    finally:
        _request.reset(token)


def build_provenance(
    scene: Scene | None = None, *, evaluator: str | None = None, accuracy: float | None = None, seed: int | None = None
) -> Provenance:
    """Return the provenance block.

    Parameters
    ----------
    scene
        The evaluated scene, if it is a single one; default: the scene of the command line.
    evaluator
        The evaluator requested or used; an evaluator on the command line takes precedence.
    accuracy
        The accuracy requested; the command line takes precedence.
    seed
        The seed of the random numbers; the command line takes precedence.
    """
    request = _request.get() or NO_REQUEST
    settings = {"evaluator": evaluator, "accuracy": accuracy, "seed": seed} | request.settings
    return {
        "format": BLOCK_FORMAT,
        "version": BLOCK_VERSION,
        "program": find_version(DISTRIBUTION),
        "dependencies": {name: number for name in DEPENDENCIES if (number := find_version(name)) is not None},
        "scene": _compute_digest(request.scene if scene is None else scene),
        **settings,
        "command": list(request.words) or None,
        "inputs": dict(request.inputs),
    }


def _compute_digest(scene: Scene | Path | None) -> str | None:
    """Return the digest of a scene, or of a scene file; None without a scene."""
    try:
        return None if scene is None else compute_scene_digest(read_scene(scene) if isinstance(scene, Path) else scene)
    except InputError:
        return None


def _remove_folders(word: str) -> str:
    """Return a word of a command line with each absolute path replaced by its last name."""
    return _FROM_ROOT.sub(r"\1", word)


@lru_cache(maxsize=32)
def find_version(name: str) -> str | None:
    """Return the version of a distribution; None where it is not installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return None


def compute_digest(content: Mapping[str, object]) -> str:
    """Return the SHA-256 of a table of numbers and texts, numbers rounded to ``DIGEST_DIGITS``.

    The order of keys does not count.
    """
    return hashlib.sha256(json.dumps(_round_numbers(content), sort_keys=True, default=str).encode()).hexdigest()


def compute_scene_digest(scene: Scene) -> str:
    """Return the digest of a scene: it depends neither on units and defaults in its file, nor on the names of surface files."""
    tables = scene.model_dump()
    for body in tables["inclusion"]:
        if body["surface"] is not None:
            body["surface"] = compute_file_digest(Path(body["surface"])) or Path(body["surface"]).name
    return compute_digest(tables)


def compute_file_digest(path: Path) -> str | None:
    """Return the SHA-256 of a file's content; None for a pipe or a folder, and for a file that is too large or unreadable."""
    try:
        if not path.is_file() or path.stat().st_size > MAX_DIGEST_BYTES:
            return None
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return None


def _round_numbers(value: object) -> object:
    """Return a value with all floats in it as texts of ``DIGEST_DIGITS`` digits."""
    if isinstance(value, float):
        return f"{value:.{DIGEST_DIGITS}g}"
    if isinstance(value, Mapping):
        return {key: _round_numbers(element) for key, element in value.items()}
    return [_round_numbers(element) for element in value] if isinstance(value, list | tuple) else value
