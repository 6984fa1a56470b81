"""What pydantic finds wrong with a scene, as one line that says what would be right."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from geometry.common.errors import InputError, Words, did_you_mean
from geometry.scenes.scene import BlockTissue, CylinderTissue, HalfSpaceTissue, Scene
from geometry.scenes.units import Quantity

TISSUES: dict[str, type[BaseModel]] = {"cylinder": CylinderTissue, "block": BlockTissue, "half-space": HalfSpaceTissue}
_TAGGED = ("union_tag_invalid", "union_tag_not_found")


def most_telling(refused: ValidationError) -> InputError:
    """Turn one of pydantic's errors into ours: an unknown key before other faults, and those before what is missing."""
    error = min(refused.errors(include_url=False), key=_rank)
    cause = error.get("ctx", {}).get("error")
    key = _key(error)
    if isinstance(cause, InputError):
        return InputError(f"{key}.{cause.key}".lstrip("."), cause.value, cause.allowed)
    if error["type"] in _TAGGED and isinstance(error["input"], Mapping):
        value = error["input"].get("shape", Words("missing"))
        return InputError("tissue.shape", value, "'cylinder', 'block' or 'half-space'")
    value = Words("missing") if error["type"] == "missing" else error["input"]
    return InputError(key or "scene", value, _allowed(error))


def _rank(error: ErrorDetails) -> int:
    return {"extra_forbidden": 0, "missing": 2}.get(error["type"], 1)


def _key(error: ErrorDetails) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in _path(error)).lstrip(".")


def _path(error: ErrorDetails) -> list[str | int]:
    """The keys as they stand in the file: without the tag that pydantic adds for the tissue's shape."""
    path = list(error["loc"])
    if path[:1] == ["tissue"] and len(path) > 1:
        del path[1]
    return path


def _allowed(error: ErrorDetails) -> str:
    """What would be right: the keys there are, the range with its unit, the field's description, or pydantic's words."""
    if error["type"] == "extra_forbidden":
        names = _model(error).model_fields
        return f"one of {', '.join(names)}{did_you_mean(error['loc'][-1], names)}"
    if error["type"] == "quantity":
        return error["msg"]
    if error["type"] == "bool_type":
        return "true or false"
    return _described(error) or error["msg"].removeprefix("Input should be ")


def _described(error: ErrorDetails) -> str | None:
    names = tuple(part for part in error["loc"] if isinstance(part, str))
    field = _model({**error, "loc": names}).model_fields.get(names[-1]) if names else None
    if field is None:
        return "a table" if not names else f"a table, [{_key(error)}]"
    ranges = [note.allowed for note in field.metadata if isinstance(note, Quantity)]
    return field.description or next(iter(ranges), None) or (f"a table, [{_key(error)}]" if _nested(field) else None)


def _model(error: ErrorDetails) -> type[BaseModel]:
    """The model that the key at fault belongs to."""
    if error["loc"][0] == "tissue" and len(error["loc"]) > 2:
        return TISSUES[str(error["loc"][1])]
    model: type[BaseModel] = Scene
    for part in error["loc"][:-1]:
        if isinstance(part, str):
            model = _nested(model.model_fields[part]) or model
    return model


def _nested(field: FieldInfo) -> type[BaseModel] | None:
    """The model, or the first of several, that a field holds."""
    return _first_model(field.annotation)


def _first_model(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((model for model in map(_first_model, get_args(annotation)) if model is not None), None)
