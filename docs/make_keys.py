"""Write ``scene-file.md``, every key of a scene file, from the models that read it."""

from __future__ import annotations

import re
import types
from collections.abc import Iterator
from inspect import cleandoc, getdoc
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import TISSUE_MODELS
from geometry.scenes.units import Quantity

PAGE = Path(__file__).parent / "reference" / "scene-file.md"
HEAD = """\
# The scene file

A TOML file: one probe on one piece of tissue. A quantity is a text with its unit, `"5 mm"`, `"1 kPa"`; a bare number where a unit
belongs is refused, as is a key that is not here. Axes: the origin is the middle of the tissue's top, z out of the tissue, x along
a block's length. In Python the same keys are arguments of the models in `geometry`, numbers then being in SI units.
`examples/scene.toml` is a small scene, `examples/two-tumours.toml` a fuller one.

Every value has a path: `probe.gap`, `tissue.layer[0].thickness`, `inclusion[1].depth`, or `inclusion.depth` where there is one
inclusion. Sweeps, tolerances, messages name values by it. In Python `scene.replace({"probe.gap": "0.2 mm", "load.force": 0.01})`
returns the scene with other values, texts with units or SI numbers. A key that excludes a new one goes, as `area_ratio` where
`outer_radius` is new, and a varied modulus takes the material's name with it.

This page is what `python docs/make_keys.py` finds in the models: run it after every change of theirs.
"""


def page() -> str:
    """Return the page."""
    lines, first = [HEAD], dict[type[BaseModel], str]()
    for heading, model in _tables():
        lines += [f"## `{heading}`", "", f"The keys of `{first[model]}`.", ""] if model in first else _section(heading, model)
        first.setdefault(model, heading)
    return "\n".join(lines)


def _tables() -> Iterator[tuple[str, type[BaseModel]]]:
    """Headings as they stand in the file, with their models."""
    yield from _list_below("", Scene)


def _list_below(path: str, model: type[BaseModel]) -> Iterator[tuple[str, type[BaseModel]]]:
    for name, field in model.model_fields.items():
        inner = f"{path}.{name}".lstrip(".")
        for kind, several in _models(field.annotation):
            heading = f"[[{inner}]]" if several else f"[{inner}]"
            shape = next((tag for tag, tissue in TISSUE_MODELS.items() if tissue is kind), None)
            yield heading if shape is None else f'{heading} with shape = "{shape}"', kind
            if shape in (None, "cylinder"):  # layers are the same in tissue of every shape
                yield from _list_below(inner, kind)


def _models(annotation: Any, several: bool = False) -> Iterator[tuple[type[BaseModel], bool]]:
    """Yield the models that a field holds, and whether it holds several of them."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation, several
        return
    for part in get_args(annotation):
        yield from _models(part, several or get_origin(annotation) is tuple)


def _section(heading: str, model: type[BaseModel]) -> Iterator[str]:
    said = getdoc(model) or ""
    keys = [(name, field) for name, field in model.model_fields.items() if not any(_models(field.annotation))]
    table, _, shape = heading.partition(" with ")
    yield f"## `{table}`" + (f" with `{shape}`" if shape else "")
    yield ""
    yield _paragraph(said.partition("\n\nAttributes\n")[0].replace("\n\n", "\n"))
    yield ""
    if keys:
        yield from ("| key | what it may be | left out | meaning |", "|---|---|---|---|")
        descriptions = {name: text for kind in reversed(model.__mro__) for name, text in _attributes(kind.__doc__ or "").items()}
        yield from (
            f"| `{name}` | {_allowed(field)} | {_default(field)} | {descriptions.get(name, '')} |" for name, field in keys
        )
        yield ""


def _paragraph(text: str) -> str:
    return " ".join(text.split()).replace("``", "`").replace("|", "\\|")


def _attributes(said: str) -> dict[str, str]:
    """Return the description of each key in a docstring."""
    block = cleandoc(said).partition("Attributes\n----------\n")[2]
    matches = re.findall(r"^(\w[\w, ]*)\n((?: {4}.*\n?)+)", block, re.M)
    return {name: _paragraph(text).rstrip(".") for names, text in matches for name in names.split(", ")}


def _allowed(field: FieldInfo) -> str:
    """Describe the allowed values of a key: the range with its unit, the words of its model, or the values."""
    if field.description:
        return _paragraph(field.description)
    notes = [note for note in (*field.metadata, *_notes(field.annotation)) if isinstance(note, Quantity)]
    if notes:
        return notes[0].allowed
    words = [f'`"{value}"`' for value in _literals(field.annotation)]
    if words:
        return ", ".join(words)
    described = [note.description for note in _notes(field.annotation) if isinstance(note, FieldInfo) and note.description]
    plain = {bool: "`true` or `false`", float: "a number", str: "a text"}
    return (
        described[0]
        if described
        else next(text for kind, text in plain.items() if kind in (field.annotation, *get_args(field.annotation)))
    )


def _notes(annotation: Any) -> Iterator[Any]:
    """Yield the metadata of an annotation, such as ``Annotated[float, Quantity(...)] | None``."""
    yield from getattr(annotation, "__metadata__", ())
    if get_origin(annotation) in (Union, types.UnionType):
        for part in get_args(annotation):
            yield from _notes(part)


def _literals(annotation: Any) -> Iterator[Any]:
    if get_origin(annotation) is Literal:
        yield from get_args(annotation)
    for part in get_args(annotation):
        if not isinstance(part, str):
            yield from _literals(part)


def _default(field: FieldInfo) -> str:
    """Return the default of a key, as text."""
    if field.is_required():
        return "required"
    quantity = next((note for note in (*field.metadata, *_notes(field.annotation)) if isinstance(note, Quantity)), None)
    value = field.default
    if value is None:
        return "-"
    if quantity is not None and isinstance(value, float):
        return quantity.format_value(value)
    return str(value).lower() if isinstance(value, bool) else str(list(value)) if isinstance(value, tuple) else f"{value}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
