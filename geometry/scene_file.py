"""Scenes as TOML: quantity strings with units; every refusal is one line naming key, value and remedy."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from geometry.errors import InputError, Words
from geometry.scene import BlockTissue, CylinderTissue, HalfSpaceTissue, Scene
from geometry.units import Quantity

LARGEST_FILE = 1_000_000  # bytes; a scene has a few hundred


def read_scene(path: Path) -> Scene:
    """Read the scene file at ``path``.

    Raises:
        InputError: the file is missing, no TOML, empty, or says something that is not allowed.
    """
    return scene_from_toml(_text(path), str(path))


def scene_from_toml(text: str, name: str = "scene") -> Scene:
    """Read a scene from TOML text; ``name`` stands in messages. Raises ``InputError``."""
    try:
        data = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as fault:
        raise InputError(name, Words(f"not TOML: {fault}"), "a TOML scene file") from None
    if not data:
        raise InputError(name, Words("empty"), "a scene with [probe], [tissue] and [load]")
    return scene_from_dict(data)


def scene_from_dict(data: dict[str, Any]) -> Scene:
    """Build a scene from the tables of a scene file, quantities as strings. Raises ``InputError``."""
    try:
        return Scene.model_validate(data, context={"units_required": True})
    except ValidationError as refused:
        raise _first(refused, data) from None


def scene_to_dict(scene: Scene) -> dict[str, Any]:
    """Return the tables of a scene file that reads back as the same scene."""
    tables: dict[str, Any] = scene.model_dump(mode="json", exclude_none=True, exclude_unset=True)
    return tables


def scene_to_toml(scene: Scene) -> str:
    """Return the text of a scene file that reads back as the same scene."""
    import tomli_w

    return tomli_w.dumps(scene_to_dict(scene))


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise InputError("scene file", str(path), f"a TOML file of at most {LARGEST_FILE} bytes")
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise InputError("scene file", str(path), "a TOML file, which is UTF-8 text") from None
    except (OSError, ValueError) as fault:
        if isinstance(fault, InputError):
            raise
        reason = getattr(fault, "strerror", None) or str(fault)
        raise InputError("scene file", str(path), f"a TOML file that can be read ({reason})") from None


def _first(refused: ValidationError, data: dict[str, Any]) -> InputError:
    """Turn the most telling of pydantic's errors into one line: an unknown key before what it left missing."""
    error = min(refused.errors(), key=lambda error: error["type"] != "extra_forbidden")
    key, given = _key(error), error["input"]
    if error["type"] == "extra_forbidden":
        return InputError(key, given, "one of " + ", ".join(_model(error).model_fields))
    if error["type"] in ("union_tag_invalid", "union_tag_not_found"):
        return InputError("tissue.shape", _given(data), "'cylinder', 'block' or 'half-space'")
    if error["type"] == "missing":
        return InputError(key, Words("missing"), _what(error) or "a value")
    cause = error.get("ctx", {}).get("error")
    if isinstance(cause, InputError):
        return InputError(f"{key}.{cause.key}".lstrip("."), cause.value, cause.allowed)
    if error["type"] == "quantity":
        return InputError(key, given, error["msg"].removeprefix("allowed: "))
    return InputError(key, given, _what(error) or error["msg"].removeprefix("Input should be "))


def _given(data: dict[str, Any]) -> object:
    tissue = data.get("tissue")
    return tissue.get("shape", Words("missing")) if isinstance(tissue, dict) else tissue


def _path(error: ErrorDetails) -> list[str | int]:
    """The keys as they stand in the file: without the tag that pydantic adds for the tissue's shape."""
    path = list(error["loc"])
    if path[:1] == ["tissue"] and len(path) > 1:
        del path[1]
    return path


def _key(error: ErrorDetails) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in _path(error)).lstrip(".")


def _model(error: ErrorDetails) -> type[BaseModel]:
    """The model that the key at fault belongs to."""
    if error["loc"][0] == "tissue":
        return {"cylinder": CylinderTissue, "block": BlockTissue, "half-space": HalfSpaceTissue}[str(error["loc"][1])]
    model: type[BaseModel] = Scene
    for part in error["loc"][:-1]:
        if isinstance(part, str):
            model = _models_in(model.model_fields[part].annotation)
    return model


def _models_in(annotation: Any) -> type[BaseModel]:
    while not isinstance(annotation, type) or not issubclass(annotation, BaseModel):
        annotation = next(a for a in annotation.__args__ if a is not Ellipsis and a is not type(None))
    return annotation


def _what(error: ErrorDetails) -> str | None:
    """What the model says of the field at fault: its range with units, or its description."""
    names = [part for part in error["loc"] if isinstance(part, str)]
    field = _model({**error, "loc": tuple(names)}).model_fields.get(names[-1])
    if field is None:
        return None
    described = [note.allowed for note in field.metadata if isinstance(note, Quantity)]
    return described[0] if described else field.description
