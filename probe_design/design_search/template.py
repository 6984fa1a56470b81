"""Write a design file with all keys, which runs as it is since it contains the built-in scene."""

from __future__ import annotations

from importlib.resources import files

from probe_design.populations.template import build_template

SCENE_LINE = 'scene = "scene.toml"'
OPENING_COMMENT = """\
# The scene that all starts from stands at the end of this file, [scene.probe] and so on. In its place there may be the name of a
# scene file: scene = "scene.toml" before the first table.
"""


def build_design_template() -> str:
    """Return a commented design file with the defaults, which runs as it is."""
    text = build_template()
    line = next(text_line for text_line in text.splitlines() if text_line.startswith(SCENE_LINE))
    return text.replace(line, OPENING_COMMENT.rstrip()) + "\n" + _read_scene_tables()


def read_builtin_design_text() -> str:
    """Return the built-in design file."""
    return files("probe_design.data").joinpath("builtin_design.toml").read_text(encoding="utf-8")


def _read_scene_tables() -> str:
    """Return the scene of the built-in design file."""
    text = read_builtin_design_text()
    return text[text.index("[scene.probe]") :]
