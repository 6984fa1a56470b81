"""Write a design file with all keys, their defaults and meanings."""

from __future__ import annotations

from collections.abc import Iterator

import tomli_w
from pydantic import BaseModel

from probe_design.populations.design_file import DESIGN_SECTIONS, Design, read_builtin_design_text
from probe_design.populations.tables import LayerRanges

FILE_HEADER = """\
# A design file: `probe-design optimize DESIGN.toml -o DIR` designs a probe for these tumours, readings, noise and limits.
# A key that is a comment shows an example: without it the default stated on its line holds. Quantities have their units.

"""
SCENE_LINE = """\
scene = "scene.toml"   # its probe is the start; its tissue and inclusion hold for what [population] leaves out
"""
BUILTIN_SCENE_COMMENT = """\
# The initial scene stands at the end of this file, [scene.probe] and so on. In its place there may be the name of a scene file:
# scene = "scene.toml" before the first table.
"""


def build_template() -> str:
    """Return a commented design file with the defaults, which refers to ``scene.toml`` in the same folder."""
    return "\n".join([FILE_HEADER + SCENE_LINE, *(_format_section(name) for name in DESIGN_SECTIONS)])


def build_design_template() -> str:
    """Return a commented design file with the defaults, which runs as it is since it contains the built-in scene."""
    builtin_text = read_builtin_design_text()
    scene_tables = builtin_text[builtin_text.index("[scene.probe]") :]
    return build_template().replace(SCENE_LINE, BUILTIN_SCENE_COMMENT) + "\n" + scene_tables


def _format_section(name: str) -> str:
    """Return the text of one table of the file."""
    model = Design.model_fields[name].annotation
    assert isinstance(model, type)
    assert issubclass(model, BaseModel)
    lines = [f"[{name}]   # {_read_first_sentence(model)}", *_format_keys(model)]
    if name == "population":
        lines += ["# [[population.layer]]", *(f"# {line.removeprefix('# ')}" for line in _format_keys(LayerRanges))]
    return "\n".join([*lines, ""])


def _format_keys(model: type[BaseModel]) -> Iterator[str]:
    """Yield a line for each key of a table: its default or an example, and its meaning."""
    written: dict[str, object] = model().model_dump(mode="json", exclude_none=True)
    for key, field in model.model_fields.items():
        default = written.get(key)
        if default in ([], {}, None) and field.examples:
            yield f"# {key} = {format_toml(field.examples[0])}   # {field.description}"
        elif default != []:
            # the default positions are a long list: the example [from, to, number] expands to the same
            value = field.examples[0] if key == "positions" and field.examples else default
            yield f"{key} = {format_toml(value)}   # {field.description}"


def format_toml(value: object) -> str:
    """Return a value as one line of TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {format_toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(format_toml(item) for item in value) + "]"
    return tomli_w.dumps({"x": value}).removeprefix("x = ").strip()


def _read_first_sentence(model: type[BaseModel]) -> str:
    """Return the first paragraph of a table's docstring as one line without its full stop."""
    return " ".join((model.__doc__ or "").split("\n\n")[0].split()).rstrip(".")
