"""What pydantic finds wrong with a scene, as one line that says what would be right."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from geometry.common.errors import InputError, Words, describe_choices, suggest_word
from geometry.scenes.scene import BlockTissue, CylinderTissue, HalfSpaceTissue, Scene
from geometry.scenes.units import Quantity

TISSUE_MODELS: dict[str, type[BaseModel]] = {"cylinder": CylinderTissue, "block": BlockTissue, "half-space": HalfSpaceTissue}
_TAG_ERRORS = ("union_tag_invalid", "union_tag_not_found")


def convert_error(refused: ValidationError) -> InputError:
    """Turn one of pydantic's errors into ours: an unknown key before other faults, and those before what is missing."""
    error = min(refused.errors(include_url=False), key=_rank_error)
    cause = error.get("ctx", {}).get("error")
    key = _format_key(error)
    if isinstance(cause, InputError):
        return InputError(f"{key}.{cause.key}".lstrip("."), cause.value, cause.allowed)
    if error["type"] in _TAG_ERRORS and isinstance(error["input"], Mapping):
        value = error["input"].get("shape", Words("missing"))
        return InputError("tissue.shape", value, f"'cylinder', 'block' or 'half-space'{suggest_word(value, TISSUE_MODELS)}")
    value = Words("missing") if error["type"] == "missing" else error["input"]
    return InputError(key or "scene", value, _describe_allowed(error))


def _rank_error(error: ErrorDetails) -> int:
    return {"extra_forbidden": 0, "missing": 2}.get(error["type"], 1)


def _format_key(error: ErrorDetails) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in _find_path(error)).lstrip(".")


def _find_path(error: ErrorDetails) -> list[str | int]:
    """The keys as they stand in the file: without the tag that pydantic adds for the tissue's shape."""
    path = list(error["loc"])
    if path[:1] == ["tissue"] and len(path) > 1:
        del path[1]
    return path


def _describe_allowed(error: ErrorDetails) -> str:
    """What would be right: the keys there are, the range with its unit, the field's description, or pydantic's words."""
    if error["type"] == "extra_forbidden":
        return describe_choices(error["loc"][-1], _find_model(error).model_fields)
    if error["type"] == "quantity":
        return error["msg"]
    if error["type"] == "bool_type":
        return "true or false"
    allowed = _describe_field(error) or error["msg"].removeprefix("Input should be ")
    meant = suggest_word(error["input"], re.findall("'([^']+)'", allowed)) if error["type"] == "literal_error" else ""
    return allowed + meant


def _describe_field(error: ErrorDetails) -> str | None:
    names = tuple(part for part in error["loc"] if isinstance(part, str))
    field = _find_model({**error, "loc": names}).model_fields.get(names[-1]) if names else None
    if field is None:
        return "a table" if not names else f"a table, [{_format_key(error)}]"
    ranges = [note.allowed for note in field.metadata if isinstance(note, Quantity)]
    return (
        field.description
        or next(iter(ranges), None)
        or (f"a table, [{_format_key(error)}]" if _find_nested_model(field) else None)
    )


def _find_model(error: ErrorDetails) -> type[BaseModel]:
    """The model that the key at fault belongs to."""
    if error["loc"][0] == "tissue" and len(error["loc"]) > 2:
        return TISSUE_MODELS[str(error["loc"][1])]
    return find_model(Scene, error["loc"][:-1])


def find_model(root: type[BaseModel], path: Sequence[str | int]) -> type[BaseModel]:
    """Return the model of the table that stands under a path of keys, as far as one is known."""
    model = root
    for part in path:
        field = model.model_fields.get(part) if isinstance(part, str) else None
        model = (_find_nested_model(field) if field else None) or model
    return model


def _find_nested_model(field: FieldInfo) -> type[BaseModel] | None:
    """The model, or the first of several, that a field holds."""
    return _find_first_model(field.annotation)


def _find_first_model(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((model for model in map(_find_first_model, get_args(annotation)) if model is not None), None)
