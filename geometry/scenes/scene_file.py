"""Read and write scenes as TOML: quantity strings with units; every refusal is one line naming key, value and remedy."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from geometry.common.errors import InputError, Words
from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene


def read_scene(path: Path | str) -> Scene:
    """Read the scene file at ``path``; see ``Scene.from_file``."""
    return Scene.from_file(path)


def load_scene(scene: Scene | Path | str) -> Scene:
    """Return a scene as it is, or read it from a file.

    Raises
    ------
    InputError
        It is neither a scene nor the name of a file, or the file cannot be read.
    """
    if isinstance(scene, Scene):
        return scene
    if isinstance(scene, Path | str):
        return read_scene(scene)
    raise InputError("scene", scene, "a Scene, or the name of a scene file")


def scene_from_toml(text: str, name: str = "scene") -> Scene:
    """Read a scene from TOML text; ``name`` stands in messages. Raises ``InputError``."""
    return Scene.from_toml(text, name)


def scene_from_dict(data: Mapping[str, object]) -> Scene:
    """Build a scene from the tables of a scene file, quantities as strings. Raises ``InputError``."""
    return Scene.from_dict(data)


def scene_to_dict(scene: Scene) -> JsonObject:
    """Return the tables of a scene file that reads back as the same scene."""
    tables: JsonObject = scene.model_dump(mode="json", exclude_none=True, exclude_unset=True)
    return tables


def scene_to_toml(scene: Scene) -> str:
    """Return the text of a scene file that reads back as the same scene."""
    import tomli_w

    return tomli_w.dumps(scene_to_dict(scene))


def find_scene(entry: object, folder: Path) -> Scene:
    """Return the scene given by another file's key ``scene``: a ``Scene``, the name of a file in a folder, or its tables.

    Raises
    ------
    InputError
        It gives no scene, or one that is not allowed.
    """
    if isinstance(entry, Scene):
        return entry
    if isinstance(entry, str | Path):
        return read_scene(folder / entry)
    if isinstance(entry, Mapping):
        return scene_from_dict(dict(entry))
    value = Words("missing") if entry is None else entry
    raise InputError("scene", value, "the name of a scene file, or its tables, [scene.probe]")
