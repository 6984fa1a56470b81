"""Refuse calls of public functions whose arguments are missing, unknown or too many, in one sentence as for any other input."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import ParamSpec, TypeVar

from geometry.common.errors import InputError, Words, suggest_word

P = ParamSpec("P")
ResultT = TypeVar("ResultT")
_BEHIND_STAR = inspect.Parameter.KEYWORD_ONLY


class CallError(InputError, TypeError):
    """A call whose arguments are missing, unknown or too many; a ``TypeError`` as well, as Python raises for such calls."""


def check_call(function: Callable[P, ResultT]) -> Callable[P, ResultT]:
    """Return a function or method that refuses a call which does not fit its signature, or no truth value for a flag.

    Raises
    ------
    CallError
        When called: an argument is missing, unknown or too many.
    InputError
        When called: a parameter annotated ``bool`` is neither true nor false, which "no" in place of False would hide.
    """
    signature = inspect.signature(function)
    flags = [name for name, parameter in signature.parameters.items() if parameter.annotation == "bool"]

    @functools.wraps(function)
    def call(*values: P.args, **keywords: P.kwargs) -> ResultT:
        """Check the arguments, and call the function."""
        bound = bind_arguments(function.__qualname__, signature, values, keywords)
        for name in flags:
            check_flag(name, bound.arguments.get(name, False))
        return function(*values, **keywords)

    return call


def check_flag(name: str, value: object) -> None:
    """Raise ``InputError`` for a flag that is neither true nor false."""
    if not isinstance(value, bool):
        raise InputError(name, value, "True or False")


def bind_arguments(
    function: str, signature: inspect.Signature, values: Sequence[object], keywords: Mapping[str, object]
) -> inspect.BoundArguments:
    """Return the arguments by the parameters of a function; raise ``CallError`` where they do not fit them."""
    try:
        return signature.bind(*values, **keywords)
    except TypeError:
        pass
    parameters = {name: part for name, part in signature.parameters.items() if name not in ("self", "cls")}
    form = f"{function.removesuffix('.__init__')}({_list_names(parameters)})"
    unknown = [name for name in keywords if name not in parameters]
    if unknown:
        raise CallError(unknown[0], keywords[unknown[0]], f"{form}{suggest_word(unknown[0], parameters)}")
    given = values[len(signature.parameters) - len(parameters) :]
    places = [name for name, part in parameters.items() if part.kind is not _BEHIND_STAR]
    if len(given) > len(places):
        raise CallError(f"argument {len(places) + 1}", given[len(places)], f"{form}: what stands behind * is given by its name")
    twice = [name for name in places[: len(given)] if name in keywords]
    if twice:
        raise CallError(twice[0], keywords[twice[0]], f"given once, by its place or by its name, in {form}")
    needed = [name for name, part in parameters.items() if part.default is inspect.Parameter.empty]
    missing = next(name for name in needed if name not in (*places[: len(given)], *keywords))
    raise CallError(missing, Words("missing"), f"a value, as in {form}")


def _list_names(parameters: Mapping[str, inspect.Parameter]) -> str:
    """Return the names of parameters; those that may be left out have an equals sign, those behind the star are given by name."""
    texts = {name: name if part.default is inspect.Parameter.empty else f"{name}=" for name, part in parameters.items()}
    named = [texts[name] for name, part in parameters.items() if part.kind is _BEHIND_STAR]
    places = [texts[name] for name, part in parameters.items() if part.kind is not _BEHIND_STAR]
    return ", ".join([*places, *(["*", *named] if named else [])])
