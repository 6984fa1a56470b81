"""Check, before any work begins, that surface files exist and are of a kind that can be read."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from geometry.common.errors import InputError

if TYPE_CHECKING:
    from geometry.scenes.scene import Scene

SURFACE_SUFFIXES = (".stl", ".step", ".stp")


def check_surface_names(scene: Scene) -> None:
    """Raise ``InputError`` for a scene's surface file that is missing or of another kind, without reading it."""
    for index, body in enumerate(scene.inclusion):
        if body.surface is not None:
            check_surface_name(body.surface, f"inclusion[{index}].surface")


def check_surface_name(name: str, key: str) -> None:
    """Raise ``InputError`` for one file; ``key`` names it in messages."""
    if Path(name).suffix.lower() not in SURFACE_SUFFIXES:
        raise InputError(key, name, "a file whose name ends in .stl, .step or .stp")
    if not os.path.isfile(name):  # no pipe, device or folder; unlike Path's it never raises, as over a name that is too long
        raise InputError(key, name, "an STL or STEP file that exists")
