"""The built-in scene: the paper's numbers where it gives any, marked assumptions where it does not."""

from __future__ import annotations

from importlib.resources import files

from geometry.scene import Scene
from geometry.scene_file import scene_from_toml


def builtin_text() -> str:
    """Return the built-in scene file, with the origin of every number."""
    return files("probe_design").joinpath("builtin.toml").read_text(encoding="utf-8")


def builtin_scene() -> Scene:
    """Return the built-in scene."""
    return scene_from_toml(builtin_text(), "builtin.toml")
