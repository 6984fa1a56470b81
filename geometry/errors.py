"""The exceptions of the toolkit: each carries what was refused and the remedy."""

from __future__ import annotations


class Words(str):
    """A description in place of a value ("missing"), shown without quotes."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


class ProbeError(Exception):
    """Base of every error that the toolkit raises on purpose; its text is one line."""

    exit_code = 1


class InputError(ProbeError, ValueError):
    """A value that the toolkit refuses.

    Args:
        key: where the value stands, such as ``probe.gap``.
        value: the value as it was given.
        allowed: what would have been accepted.
    """

    exit_code = 2

    def __init__(self, key: str, value: object, allowed: str) -> None:
        self.key, self.value, self.allowed = key, value, allowed
        super().__init__(_one_line(f"{key} = {_short(value)}: allowed: {allowed}"))


class Refusal(InputError):  # noqa: N818 - the error is the scene's, not the program's
    """A scene that an evaluator cannot take; ``allowed`` says which can."""


class SolveError(ProbeError):
    """A system of equations whose solution did not pass the check of its residual."""


class ExportError(ProbeError):
    """A part that, read back from its file, is not what the parameters say."""


class MissingLibrary(ProbeError):  # noqa: N818 - says what is missing
    """A system library that a dependency needs; the text names the package to install."""


def _short(value: object, limit: int = 60) -> str:
    text = repr(value)
    return text if len(text) <= limit else text[: limit - 3] + "..."


def _one_line(text: str) -> str:
    return " ".join(text.split())
