"""The base of all requests, and the notes with which their fields state help, names and ranges."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, ParamSpec, Self, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from geometry.common.calls import bind_arguments
from geometry.common.errors import InputError, suggest_word
from geometry.common.resources import Limits
from geometry.scenes.units import Quantity, format_modulus, read_fraction, read_number

P = ParamSpec("P")
ResultT = TypeVar("ResultT")
PARAMETERS_HEADING = "Parameters\n----------\n"
NO_LABELS: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class Option:
    """How a field is given on the command line and, as the keyword of its name, in Python.

    Attributes
    ----------
    help
        What it is, in one sentence.
    names
        Names of the option, "-o/--output"; default: the field's name.
    left_out
        What holds where None is the default.
    words
        Values that a shell completes, where the range of values is not part of the type.
    is_argument
        Whether it is given by its place in place of its name.
    metavar
        Stands for an argument in help texts; default: the field's name.
    """

    help: str = ""
    names: str = ""
    left_out: str = ""
    words: tuple[str, ...] = ()
    is_argument: bool = False
    metavar: str | None = None


@dataclass(frozen=True)
class Number:
    """A number without unit as a pydantic annotation: a text on the command line, a float in Python.

    Attributes
    ----------
    allowed
        The range in words.
    is_allowed
        Whether a number is within it.
    percent
        Whether a text may be a percentage.
    """

    allowed: str
    is_allowed: Callable[[float], bool]
    percent: bool = False

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema that reads the number."""
        return core_schema.no_info_plain_validator_function(self._read)

    def _read(self, entry: object) -> float:
        """Return the number that ``entry``, a text or a number, states; raise ``PydanticCustomError`` for anything else."""
        try:
            value = (read_fraction if self.percent else read_number)("number", entry, self.allowed)
        except InputError:
            value = float("nan")  # within no range, and so refused below
        if not self.is_allowed(value):
            raise PydanticCustomError("quantity", "{allowed}", {"allowed": self.allowed})
        return value


def is_positive(value: float) -> bool:
    """Return whether a number is finite and above 0."""
    return 0 < value < math.inf


class Request(BaseModel):
    """A command with the values of its options. A subclass has a field for each, and ``run``; its docstring is the help text."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    as_json: Annotated[bool, Option("Print one JSON object.", "--json")] = False
    quiet: Annotated[bool, Option("Print no progress and no notes, only results and warnings.")] = False

    @property
    def limits(self) -> Limits | None:
        """Limits of each evaluation; None: those that are in force."""
        return None

    def run(self) -> None:
        """Carry out the command and print its result."""
        raise NotImplementedError

    def call(self, function: Callable[..., ResultT], **others: object) -> ResultT:
        """Call a function: parameters that are fields of this request have their values, others are keywords ``others``."""
        names = inspect.signature(function).parameters.keys() & type(self).model_fields.keys()
        return function(**{name: getattr(self, name) for name in names} | others)

    @classmethod
    def build(cls, values: Mapping[str, object], labels: Mapping[str, str] = NO_LABELS) -> Self:
        """Return the request with checked values.

        Parameters
        ----------
        values : mapping
            by the names of fields: texts with units, or numbers in SI units; see ``adapt_value``.
        labels : mapping
            names of fields in messages, where they differ.

        Raises
        ------
        InputError
            a value is not allowed.
        """
        values = {
            name: adapt_value(cls.model_fields[name], value) if name in cls.model_fields else value
            for name, value in values.items()
        }
        try:
            return cls.model_validate(values)
        except ValidationError as refused:
            error = refused.errors(include_url=False)[0]
        cause = error.get("ctx", {}).get("error")
        if isinstance(cause, InputError):
            raise cause
        name = str(error["loc"][0])
        if name not in cls.model_fields:
            raise InputError(name, values[name], f"one of {', '.join(cls.model_fields)}{suggest_word(name, cls.model_fields)}")
        allowed = error["msg"] if error["type"] == "quantity" else describe_allowed(cls.model_fields[name])
        raise InputError(labels.get(name, name), values.get(name), allowed)


def adapt_value(field: FieldInfo, value: object) -> object:
    """Return a value from Python as the field has it.

    The name of a file becomes a path, one entry or a list of them a tuple, and a mapping texts "key=value".
    """
    types = find_types(field)
    if get_origin(field.annotation) is tuple:
        if isinstance(value, Mapping):
            value = tuple(f"{key}={entry}" for key, entry in value.items())
        value = (value,) if isinstance(value, str | Path) else tuple(value) if isinstance(value, list) else value
    if Path not in types or str in types:
        return value
    entries = tuple(
        Path(entry) if isinstance(entry, str) else entry for entry in (value if isinstance(value, tuple) else (value,))
    )
    return entries if isinstance(value, tuple) else entries[0]


def list_fields(request: type[Request]) -> dict[str, FieldInfo]:
    """List the fields of a request that are options, by name: its own first, those that all requests have last."""
    names = dict.fromkeys(name for kind in request.__mro__ for name in inspect.get_annotations(kind))
    fields = {name: request.model_fields[name] for name in names if name in request.model_fields}
    return {name: field for name, field in fields.items() if any(isinstance(note, Option) for note in field.metadata)}


def find_option(field: FieldInfo) -> Option:
    """Return the option of a field; a later note replaces an earlier one."""
    return [note for note in field.metadata if isinstance(note, Option)][-1]


def iterate_types(annotation: Any) -> Iterator[Any]:
    """Yield the types and the notes within an annotation such as ``Annotated[float, Quantity(...)] | None``."""
    if get_origin(annotation) is Literal or not get_args(annotation):
        yield annotation
        return
    for part in get_args(annotation):
        yield from iterate_types(part)


def find_types(field: FieldInfo) -> list[Any]:
    """Return all types and notes of a field."""
    return [*field.metadata, *iterate_types(field.annotation)]


def find_range(field: FieldInfo) -> tuple[int, int]:
    """Return the lower and upper limit of a field that is a whole number, from its pydantic notes ``ge`` and ``le``."""
    low, high = (next(getattr(note, key) for note in field.metadata if hasattr(note, key)) for key in ("ge", "le"))
    return low, high


def describe_allowed(field: FieldInfo) -> str:
    """Describe in words the values that a field may have."""
    parts = find_types(field)
    for part in parts:
        if isinstance(part, Quantity | Number):
            return part.allowed
        if get_origin(part) is Literal:
            return " or ".join(map(repr, get_args(part)))
    if field.description:
        return field.description
    if bool in parts:
        return "true or false"
    if int in parts:
        return "a whole number from {} to {}".format(*find_range(field))
    return "the name of a file or folder" if Path in parts else "a text"


def format_default(field: FieldInfo) -> str:
    """Return the default of a field as a text of the command line; "" where there is none."""
    value = field.default
    if value is None or value is False or value == () or field.is_required():
        return find_option(field).left_out
    quantity = next((part for part in find_types(field) if isinstance(part, Quantity)), None)
    if quantity is not None:
        return format_modulus(value) if quantity.name == "modulus" else quantity.format_value(value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def use_request(request: type[Request], *, checks: bool = True) -> Callable[[Callable[P, ResultT]], Callable[P, ResultT]]:
    """Return a decorator that gives a function the checks and the help of a request's fields.

    Parameters of the function that have the name of a field are checked like this field, unless ``checks`` is false because the
    function builds the request itself. The help of those that its docstring does not describe is added to it.
    Keywords ``**others: Unpack[...]`` of a ``TypedDict`` stand for the fields that it names, with the request's defaults.
    """

    def decorate(function: Callable[P, ResultT]) -> Callable[P, ResultT]:
        """Return the function with the request's checks and help."""
        fields = list_fields(request)
        signature = _expand_signature(inspect.signature(function), function, fields)

        @functools.wraps(function)
        def check_and_call(*values: P.args, **keywords: P.kwargs) -> ResultT:
            """Check the parameters that are fields of the request, and call the function."""
            bound = bind_arguments(function.__name__, signature, values, keywords)
            if not checks:
                return function(*bound.args, **bound.kwargs)
            # parameters that the caller left out keep the function's own default, unchecked
            given = {name: value for name, value in bound.arguments.items() if name in fields}
            checked = request.build(given)
            bound.arguments.update({name: getattr(checked, name) for name in given})
            return function(*bound.args, **bound.kwargs)

        text = inspect.getdoc(function) or ""
        names = [name for name in signature.parameters if name in fields and f"\n{name} : " not in text]
        lines = [_describe_parameter(name, fields[name]) for name in names]
        check_and_call.__signature__ = signature  # type: ignore[attr-defined]
        check_and_call.__doc__ = text.replace(PARAMETERS_HEADING, PARAMETERS_HEADING + "".join(lines), 1)
        return check_and_call

    return decorate


def _expand_signature(
    signature: inspect.Signature, function: Callable[..., object], fields: Mapping[str, FieldInfo]
) -> inspect.Signature:
    """Return the signature with a keyword for each field that ``**others: Unpack[...]`` stands for."""
    parameters = list(signature.parameters.values())
    if not parameters or parameters[-1].kind is not inspect.Parameter.VAR_KEYWORD:
        return signature
    keys = function.__globals__[parameters.pop().annotation.removeprefix("Unpack[").removesuffix("]")].__annotations__
    parameters += [
        inspect.Parameter(
            name, inspect.Parameter.KEYWORD_ONLY, default=fields[name].default, annotation=annotation.__forward_arg__
        )
        for name, annotation in keys.items()
        if name in fields
    ]
    return signature.replace(parameters=parameters)


def _describe_parameter(name: str, field: FieldInfo) -> str:
    """Return the entry of a parameter in the section Parameters of a docstring."""
    default = format_default(field)
    quantities = [f", {part.si}" for part in find_types(field) if isinstance(part, Quantity)]
    heading = f"{name} : {describe_allowed(field)}{''.join(quantities)}{f'; default: {default}' if default else ''}"
    return f"{heading}\n    {find_option(field).help}\n"
