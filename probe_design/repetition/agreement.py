"""Compare the numbers of two results of one command: they agree if they differ by no more than the errors that both state.

With e and e' the error estimates of two values x and x', and ROUNDING = 1e-6, they agree where

    |x - x'| <= (k (e + e') + ROUNDING) max(|x|, |x'|)                                               (RP.1)

k is 1, and 5 for a log-sensitivity, for which an accuracy means five times the error; without an error estimate e is 0.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

ROUNDING = 1e-6  # relative: differences between processors and libraries
SMALLEST = 1e-5  # absolute, of a log-sensitivity, as documented for the accuracy
# keys that describe a run and not its result, or repeat numbers in words
ASIDE = {
    "seconds", "provenance", "files", "folder", "answered", "warnings", "plan", "verdict", "remarks", "reason", "versions",
    "residual", "p_value", "date", "asked", "version", "program",
}  # fmt: skip
_QUANTITY = re.compile(r"\s*([+-]?[0-9.]+(?:[eE][+-]?[0-9]+)?)\s*([^\s0-9][^0-9]*)?\s*")


@dataclass(frozen=True)
class Difference:
    """A value in which two results differ.

    Attributes:
        place: path of keys, such as ``result.ratio``.
        recorded, repeated: the two values; None if missing.
    """

    place: str
    before: object
    now: object

    def __str__(self) -> str:
        """Describe the difference in one line."""
        return f"{self.place}: {_short(self.before)} then, {_short(self.now)} now"


def compared(before: Mapping[str, Any], now: Mapping[str, Any]) -> int:
    """Return the number of values that are compared."""
    return sum(1 for _ in _pairs(before, now, ""))


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[Difference]:
    """Return the values in which two results differ by more than their errors, eq. RP.1."""
    return [
        Difference(place, one, other) for place, one, other, allowed in _pairs(before, now, "") if not _agree(one, other, allowed)
    ]


Errors = tuple[Any, Any]  # error estimates of two values: numbers, lists of them, or None
Pair = tuple[str, Any, Any, tuple[float, float]]


def _pairs(one: Any, other: Any, place: str, errors: Errors = (None, None)) -> Iterator[Pair]:
    """Yield the leaves of both trees: place, values, and their allowed difference, relative and absolute."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        beside = one.get("error_estimate"), other.get("error_estimate")
        for key in [key for key in {**one, **other} if key not in ASIDE and key != "error_estimate"]:
            yield from _pairs(one.get(key), other.get(key), f"{place}.{key}".lstrip("."), beside)
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for k, (left, right) in enumerate(zip(one, other, strict=True)):
            yield from _pairs(left, right, f"{place}[{k}]", (_entry(errors[0], k, len(one)), _entry(errors[1], k, len(one))))
    elif one is not None or other is not None:
        yield place, one, other, _allowed(place, errors)


def _entry(error: Any, k: int, count: int) -> Any:
    """Return the error of entry ``k`` of an array: its own if there is one for each, else the common one."""
    return error[k] if isinstance(error, list) and len(error) == count else error


def _allowed(place: str, errors: Errors) -> tuple[float, float]:
    """Return the allowed relative and absolute difference, eq. RP.1."""
    both = sum(one for one in errors if _is_number(one) and one > 0)
    return (5 * both, SMALLEST) if "log_sensitivity" in place else (both, 0.0)


def _agree(one: Any, other: Any, allowed: tuple[float, float]) -> bool:
    """Return whether two leaves agree: texts and booleans exactly, numbers within the allowed difference."""
    if isinstance(one, str) and isinstance(other, str):
        return one == other or _quantities_agree(one, other)
    if not (_is_number(one) and _is_number(other)):
        return bool(one == other)
    return math.isclose(one, other, rel_tol=allowed[0] + ROUNDING, abs_tol=allowed[1])


def _quantities_agree(one: str, other: str) -> bool:
    """Return whether two texts are the same quantity up to rounding, such as ``4.31 mm``."""
    left, right = _QUANTITY.fullmatch(one), _QUANTITY.fullmatch(other)
    if left is None or right is None or left[2] != right[2]:
        return False
    return math.isclose(float(left[1]), float(right[1]), rel_tol=ROUNDING)


def _short(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else repr(value)[:60]


def _is_number(value: Any) -> bool:
    """Return whether a value is a finite number; integers in a damaged file may exceed the range of floats."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max
