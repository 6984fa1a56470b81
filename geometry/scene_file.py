"""Scenes as TOML: quantity strings with units; every refusal is one line naming key, value and remedy."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from geometry.errors import InputError, Words
from geometry.refusals import most_telling
from geometry.scene import Scene

LARGEST_FILE = 1_000_000  # bytes; a scene has a few hundred
# tomllib's time and the depth of what it returns grow with the parts of a dotted key; a scene's keys have three
_LONG_KEY = re.compile(r"(?:\.[^.\n]*){100}")


def read_scene(path: Path | str) -> Scene:
    """Read the scene file at ``path``; names of surface files in it are relative to its folder.

    Raises:
        InputError: the file is missing, no TOML, empty, or says something that is not allowed.
    """
    scene, folder = scene_from_toml(_text(path), str(path)), Path(path).parent
    if all(body.surface is None for body in scene.inclusion):
        return scene
    bodies = (
        body if body.surface is None else body.model_copy(update={"surface": str(folder / body.surface)})
        for body in scene.inclusion
    )
    return scene.model_copy(update={"inclusion": tuple(bodies)})


def scene_from_toml(text: str, name: str = "scene") -> Scene:
    """Read a scene from TOML text; ``name`` stands in messages. Raises ``InputError``."""
    if _LONG_KEY.search(text):
        raise InputError(name, Words("a line with 100 dots"), "a TOML scene file with fewer dots in each line")
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as fault:
        raise InputError(name, Words(f"not TOML: {fault}"), "a TOML scene file") from None
    except (ValueError, RecursionError):  # as Python's limits on the digits of integers and on the depth of calls
        raise InputError(name, Words("TOML with a huge integer or deep nesting"), "a TOML scene file") from None
    if not data:
        raise InputError(name, Words("empty"), "a scene with [probe], [tissue] and [load]")
    return scene_from_dict(data)


def scene_from_dict(data: dict[str, Any]) -> Scene:
    """Build a scene from the tables of a scene file, quantities as strings. Raises ``InputError``."""
    try:
        return Scene.model_validate(data, context={"units_required": True})
    except ValidationError as refused:
        raise most_telling(refused) from None


def scene_to_dict(scene: Scene) -> dict[str, Any]:
    """Return the tables of a scene file that reads back as the same scene."""
    tables: dict[str, Any] = scene.model_dump(mode="json", exclude_none=True, exclude_unset=True)
    return tables


def scene_to_toml(scene: Scene) -> str:
    """Return the text of a scene file that reads back as the same scene."""
    import tomli_w

    return tomli_w.dumps(scene_to_dict(scene))


def _text(path: Path | str) -> str:
    try:
        with Path(path).open("rb") as file:
            content = file.read(LARGEST_FILE + 1)  # no more: devices and pipes have no size to ask for
    except (OSError, ValueError) as fault:
        reason = getattr(fault, "strerror", None) or str(fault)
        raise InputError("scene file", str(path), f"a TOML file that can be read ({reason})") from None
    if len(content) > LARGEST_FILE:
        raise InputError("scene file", str(path), f"a TOML file of at most {LARGEST_FILE} bytes")
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError:
        raise InputError("scene file", str(path), "a TOML file, which is UTF-8 text") from None
