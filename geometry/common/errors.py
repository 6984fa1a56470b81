"""The exceptions of the toolkit: each carries the refused value and the remedy."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable
from difflib import get_close_matches
from importlib import import_module
from typing import Any


class Words(str):
    """A description in place of a value ("missing"), shown without quotes."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


class ProbeError(Exception):
    """Base of every error that the toolkit raises on purpose; its text is one line."""

    exit_code = 1

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what a pickle needs: the text and the attributes, as constructors take other arguments than the text."""
        return _restore_error, (type(self), self.args, self.__dict__)


class InputError(ProbeError, ValueError):
    """A value that the toolkit refuses.

    Parameters
    ----------
    key
        Where the value stands, such as ``probe.gap``.
    value
        The value as it was given.
    allowed
        What is accepted.
    """

    exit_code = 2

    def __init__(self, key: str, value: object, allowed: str) -> None:
        self.key, self.value, self.allowed = key, value, allowed
        super().__init__(to_one_line(f"{_shorten(key, 120)} = {_describe_value(value)}: allowed: {allowed}"))


class ObsoleteKeyWarning(FutureWarning):
    """A key of a file that the next version refuses; the text says what to write instead."""


class Refusal(InputError):  # noqa: N818 - the error is the scene's, not the program's
    """A scene that an evaluator cannot take; ``allowed`` says which can."""


class SolveError(ProbeError):
    """A system of equations whose solution did not pass the check of its residual."""


class ExportError(ProbeError):
    """A part that, read back from its file, deviates from the parameters."""


class MissingLibrary(ProbeError):  # noqa: N818 - says what is missing
    """A system library that a dependency needs; the text names the package to install."""


def _restore_error(kind: type[ProbeError], arguments: tuple[Any, ...], attributes: dict[str, Any]) -> ProbeError:
    """Return an error from a pickle, without its constructor."""
    error = kind.__new__(kind, *arguments)
    error.__dict__.update(attributes)
    return error


def import_extra(name: str) -> Any:
    """Import a library of the optional dependencies ``sweep``. Raises ``MissingLibrary`` where it is not installed."""
    try:
        return import_module(name)
    except ImportError:
        raise MissingLibrary(f"{name.split('.')[0]} is not installed: pip install '.[sweep]' brings it") from None


def suggest_word(word: object, words: Iterable[str]) -> str:
    """Return "; did you mean ...?" if one of ``words`` resembles ``word``, else an empty text."""
    matches = get_close_matches(str(word).lower()[:100], [*words], n=1) if isinstance(word, str) else []
    return f"; did you mean {matches[0]!r}?" if matches else ""


def describe_choices(word: object, words: Iterable[str]) -> str:
    """Return "one of ..." with all of ``words``, and a suggestion if one of them resembles ``word``."""
    known = [*words]
    return f"one of {', '.join(known)}{suggest_word(word, known)}"


class _Repr(reprlib.Repr):
    """Short descriptions of values as a TOML file has them, of any depth and size."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxdict, self.maxlist = 3, 4, 6
        self.maxstring = self.maxother = 100

    def repr_bool(self, value: bool, level: int) -> str:
        """Describe a boolean as TOML writes it."""
        return str(value).lower()

    def repr_int(self, value: int, level: int) -> str:
        """Describe an integer, a huge one by its size."""
        # Python refuses to write integers of more than 4300 digits
        return self.repr_str(str(value), level).strip("'") if value.bit_length() < 10_000 else f"<{value.bit_length()} bits>"


_VALUE_REPR = _Repr()


def _describe_value(value: object) -> str:
    """Describe a refused value in at most 200 characters."""
    return _shorten(str(value) if isinstance(value, Words) else _VALUE_REPR.repr(value), 200)


def _shorten(text: str, limit: int) -> str:
    """Return a text without its middle where it is longer than a limit."""
    half = limit // 2 - 2
    return text if len(text) <= limit else f"{text[:half]}...{text[-half:]}"


def to_one_line(text: str) -> str:
    """Join a text into one line and escape characters that cannot be printed."""
    return escape_unprintable(" ".join(text.split()))


def escape_unprintable(text: str) -> str:
    """Escape characters that cannot be printed, such as control codes of a terminal."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
