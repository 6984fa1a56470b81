"""The design file with every key, ready to run as it is: the built-in scene stands in it."""

from __future__ import annotations

from importlib.resources import files

from probe_design.populations.template import template

SCENE = 'scene = "scene.toml"'
OPENING = """\
# The scene that all starts from stands at the end of this file, [scene.probe] and so on. In its place there may be the name of a
# scene file: scene = "scene.toml" before the first table.
"""


def whole_template() -> str:
    """Return a commented design file that reads as the defaults and runs as it is."""
    text = template()
    line = next(one for one in text.splitlines() if one.startswith(SCENE))
    return text.replace(line, OPENING.rstrip()) + "\n" + _scene_tables()


def builtin_design_text() -> str:
    """Return the built-in design file."""
    return files("probe_design.data").joinpath("builtin_design.toml").read_text(encoding="utf-8")


def _scene_tables() -> str:
    """The scene of the built-in design file."""
    text = builtin_design_text()
    return text[text.index("[scene.probe]") :]
