"""Convert pydantic's errors about a file's tables to messages of one line that state what is allowed."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from geometry.common.errors import InputError, Words, describe_choices, suggest_word
from geometry.scenes.units import Quantity

_TABLES_NAMED = 3  # tables that a message names for a key in the wrong place: more would hide the point
_UNION_TYPES = ("literal", "float", "constrained")  # as pydantic begins their names in a path; no key of a file begins so
_TAG_ERRORS = ("union_tag_invalid", "union_tag_not_found")


def convert_error(refused: ValidationError, model: type[BaseModel], label: str = "scene") -> InputError:
    """Convert one of pydantic's errors about ``model``'s tables to ours: unknown keys first, missing values last.

    ``label`` stands for the key where the tables as a whole are wrong.
    """
    error = min(refused.errors(include_url=False), key=_rank_error)
    cause = error.get("ctx", {}).get("error")
    key = _format_key(error)
    if isinstance(cause, InputError):
        return InputError(f"{key}.{cause.key}".strip("."), cause.value, cause.allowed)
    if error["type"] in _TAG_ERRORS and isinstance(error["input"], Mapping):
        value = error["input"].get("shape", Words("missing"))
        return InputError("tissue.shape", value, f"'cylinder', 'block' or 'half-space'{_suggest_tag(error)}")
    value = Words("missing") if error["type"] == "missing" else error["input"]
    return InputError(key or label, value, _describe_allowed(error, model))


def _rank_error(error: ErrorDetails) -> int:
    """Return the rank of an error: 0 for unknown keys, 2 for missing ones, else 1; the lowest is reported."""
    return {"extra_forbidden": 0, "missing": 2}.get(error["type"], 1)


def _format_key(error: ErrorDetails) -> str:
    """Return the key of an error as a user writes it, such as ``inclusion[0].depth``."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in _find_path(error)).lstrip(".")


def _find_path(error: ErrorDetails) -> list[str | int]:
    """Return the keys as they are in the file: without the tag that pydantic adds for the tissue's shape."""
    path = _find_tagged_path(error)
    if path[:1] == ["tissue"] and len(path) > 1:
        del path[1]
    return path


def _find_tagged_path(error: ErrorDetails) -> list[str | int]:
    """Return the keys with the tag of the tissue's shape, without the types of a union, which pydantic adds as well."""
    return [part for part in error["loc"] if isinstance(part, int) or not part.startswith(_UNION_TYPES)]


def _describe_allowed(error: ErrorDetails, model: type[BaseModel]) -> str:
    """Describe what is allowed: the keys, the range with its unit, the field's description, or pydantic's own text."""
    if error["type"] == "extra_forbidden":
        key, table = error["loc"][-1], find_model(model, error["loc"][:-1])
        homes = [path for path, home in _iterate_tables(model) if home is not table and key in home.model_fields]
        return describe_choices(key, table.model_fields) + (f"; {key!r} is a key of {_join_tables(homes)}" if homes else "")
    if error["type"] == "quantity":
        return error["msg"]
    if error["type"] == "bool_type":
        return "true or false"
    allowed = _describe_field(error, model) or error["msg"].removeprefix("Input should be ")
    meant = suggest_word(error["input"], re.findall("'([^']+)'", allowed)) if error["type"] == "literal_error" else ""
    return allowed + meant


def _describe_field(error: ErrorDetails, model: type[BaseModel]) -> str | None:
    """Describe what a field allows: its description, its range or that it is a table; None where neither is known."""
    names = tuple(part for part in _find_tagged_path(error) if isinstance(part, str))
    field = find_model(model, names[:-1]).model_fields.get(names[-1]) if names else None
    if field is None:
        return "a table" if not names else f"a table, [{_format_key(error)}]"
    ranges = [note.allowed for note in field.metadata if isinstance(note, Quantity)]
    return (
        field.description
        or next(iter(ranges), None)
        or next(_iterate_descriptions(field.annotation), None)
        or (f"a table, [{_format_key(error)}]" if list_models(field.annotation) else None)
    )


def _iterate_descriptions(annotation: object) -> Iterator[str]:
    """Yield the descriptions in an annotation, such as that of ``Number`` in ``Number | None``."""
    for part in get_args(annotation):
        notes = getattr(part, "__metadata__", ())
        yield from (note.description for note in notes if isinstance(note, FieldInfo) and note.description)
        yield from _iterate_descriptions(part)


def find_model(root: type[BaseModel], path: Sequence[str | int]) -> type[BaseModel]:
    """Return the model of the table at a path of keys and of tags of shapes, as far as one is known."""
    models = [root]
    for part in path:
        tagged = [model for model in models if part in get_args(_find_annotation(model, "shape"))]
        models = tagged or list_models(_find_annotation(models[0], part)) or models
    return models[0]


def _find_annotation(model: type[BaseModel], key: str | int) -> object:
    """Return the type annotation of a model's field; None where it has no such field."""
    field = model.model_fields.get(key) if isinstance(key, str) else None
    return None if field is None else field.annotation


def _iterate_tables(model: type[BaseModel], path: str = "") -> Iterator[tuple[str, type[BaseModel]]]:
    """Yield the tables of a file with their paths, such as ``tissue.layer``, each table before those inside it."""
    yield path, model
    for name, field in model.model_fields.items():
        for part in list_models(field.annotation):
            yield from _iterate_tables(part, f"{path}.{name}".lstrip("."))


def _join_tables(paths: Sequence[str]) -> str:
    """Return the first tables that have a key, as a file writes them."""
    tables = [f"[{path}]" if path else "the file's top level" for path in dict.fromkeys(paths)]
    return " or ".join(tables[:_TABLES_NAMED])


def _suggest_tag(error: ErrorDetails) -> str:
    """Return "; did you mean ...?" if the given shape resembles one of the allowed ones."""
    return suggest_word(error["input"].get("shape"), re.findall("'([^']+)'", error.get("ctx", {}).get("expected_tags", "")))


def list_models(annotation: object) -> list[type[BaseModel]]:
    """Return the pydantic models in a type annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in list_models(argument)]
