"""What `optimize` is asked: a design file or a scene file, their tables, or nothing, which the built-in design file answers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from geometry.common.errors import InputError
from geometry.common.text_files import read_text, tables
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene
from probe_design.design_search.template import builtin_design_text
from probe_design.populations.design_file import Design, design_from_dict, design_from_tables, is_design

Asked = Design | Scene | Path | str | Mapping[str, Any] | None
ALLOWED = "a Design or Scene, the name of a design or scene file, or the tables of a design file"


def builtin_design() -> Design:
    """Return the built-in design; its file says where every number comes from."""
    return design_from_dict(tables(builtin_design_text(), "built-in design", "a design file"), units_required=True)


def question(asked: Asked) -> Design | Scene:
    """Return what is asked; in tables from Python numbers are in SI units.

    Raises:
        InputError: it is none of ``ALLOWED_SOURCES``, or says something that is not allowed.
    """
    if asked is None:
        return builtin_design()
    if isinstance(asked, Design | Scene):
        return asked
    if isinstance(asked, Path | str):
        return read_question(Path(asked))
    if isinstance(asked, Mapping):
        return design_from_dict(asked)
    raise InputError("design", asked, ALLOWED)


def read_question(path: Path) -> Design | Scene:
    """Read a file: a design file where it has one's tables, a scene otherwise.

    Raises:
        InputError: it is missing, no TOML, or says something that is not allowed.
    """
    found = tables(read_text(path, "scene file"), str(path), "a TOML scene or design file")
    return design_from_tables(found, path) if is_design(found) else read_scene(path)
