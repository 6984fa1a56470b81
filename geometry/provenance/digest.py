"""Compute digests of the inputs from which numbers were computed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from geometry.scenes.scene import Scene

DIGEST_DIGITS = 9  # significant digits of a number: smaller differences leave the digest unchanged
LARGEST_FILE = 4_000_000_000  # bytes: read in some seconds; larger files get no digest


def compute_digest(content: Mapping[str, object]) -> str:
    """Return the SHA-256 of numbers, to ``DIGEST_DIGITS``, and texts by their names."""
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
        if not path.is_file() or path.stat().st_size > LARGEST_FILE:
            return None
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return None


def _round_numbers(value: object) -> object:
    if isinstance(value, float):
        return f"{value:.{DIGEST_DIGITS}g}"
    if isinstance(value, Mapping):
        return {key: _round_numbers(element) for key, element in value.items()}
    return [_round_numbers(element) for element in value] if isinstance(value, list | tuple) else value
