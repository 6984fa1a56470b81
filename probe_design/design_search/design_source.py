"""Read the input of `optimize`: a design file, a scene file or their tables; by default the built-in design file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from geometry.common.errors import InputError
from geometry.common.text_files import parse_tables, read_text
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import read_scene
from probe_design.design_search.template import read_builtin_design_text
from probe_design.populations.design_file import Design, design_from_dict, design_from_tables, is_design

DesignSource = Design | Scene | Path | str | Mapping[str, object] | None
ALLOWED_SOURCES = "a Design or Scene, the name of a design or scene file, or the tables of a design file"


def read_builtin_design() -> Design:
    """Return the built-in design; its file states the source of every number."""
    return design_from_dict(parse_tables(read_builtin_design_text(), "built-in design", "a design file"), units_required=True)


def read_design_source(source: DesignSource) -> Design | Scene:
    """Return the design or scene of any source; in tables from Python numbers are in SI units.

    Raises
    ------
    InputError
        The source is none of ``ALLOWED_SOURCES``, or contains a value that is not allowed.
    """
    if source is None:
        return read_builtin_design()
    if isinstance(source, Design | Scene):
        return source
    if isinstance(source, Path | str):
        return read_design_or_scene(Path(source))
    if isinstance(source, Mapping):
        return design_from_dict(source)
    raise InputError("design", source, ALLOWED_SOURCES)


def read_design_or_scene(path: Path) -> Design | Scene:
    """Read a design file or a scene file, which is recognised by its tables.

    Raises
    ------
    InputError
        The file is missing, is not TOML, or contains a value that is not allowed.
    """
    file_tables = parse_tables(read_text(path, "scene file"), str(path), "a TOML scene or design file")
    return design_from_tables(file_tables, path) if is_design(file_tables) else read_scene(path)
