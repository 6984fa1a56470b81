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

ROUNDING_RELATIVE = 1e-6  # relative: differences between processors and libraries
LOG_SENSITIVITY_TOLERANCE = 1e-5  # absolute, of a log-sensitivity, as documented for the accuracy
# keys that describe a run and not its result, repeat numbers in words, or say what may differ
IGNORED_KEYS = {
    "seconds", "provenance", "files", "folder", "answered", "warnings", "plan", "verdict", "remarks", "reason", "versions",
    "residual", "p_value", "date", "asked", "version", "program",
    "error_estimate", "stress_inner_error", "stress_outer_error", "stiffness_error",
}  # fmt: skip
_QUANTITY_PATTERN = re.compile(r"\s*([+-]?[0-9.]+(?:[eE][+-]?[0-9]+)?)\s*([^\s0-9][^0-9]*)?\s*")


@dataclass(frozen=True)
class Difference:
    """A value in which two results differ.

    Attributes
    ----------
    place
        Path of keys, such as ``result.ratio``.
    recorded, repeated
        The two values; None if missing.
    """

    place: str
    recorded: object
    repeated: object

    def __str__(self) -> str:
        """Describe the difference in one line."""
        return f"{self.place}: {_format_value(self.recorded)} then, {_format_value(self.repeated)} now"


def count_numbers(recorded: Mapping[str, object], repeated: Mapping[str, object]) -> int:
    """Return the number of values that are compared."""
    return sum(1 for _ in _iterate_pairs(recorded, repeated, ""))


def find_differences(recorded: Mapping[str, Any], repeated: Mapping[str, Any]) -> list[Difference]:
    """Return the values in which two results differ by more than their errors, eq. RP.1."""
    return [
        Difference(place, old, new)
        for place, old, new, allowed in _iterate_pairs(recorded, repeated, "")
        if not _is_equal(old, new, allowed)
    ]


Errors = tuple[Any, Any]  # error estimates of two values: numbers, lists of them, or None
Pair = tuple[str, Any, Any, tuple[float, float]]


def _iterate_pairs(recorded: Any, repeated: Any, place: str, errors: Errors = (None, None)) -> Iterator[Pair]:
    """Yield the leaves of both JSON trees: place, values, and their allowed difference, relative and absolute.

    Parameters
    ----------
    recorded, repeated
        Objects, lists or values at the same place of both trees.
    place
        Path of keys to them.
    errors
        Error estimates of the objects that contain them.
    """
    if isinstance(recorded, Mapping) and isinstance(repeated, Mapping):
        estimates = recorded.get("error_estimate"), repeated.get("error_estimate")
        for key in [key for key in {**recorded, **repeated} if key not in IGNORED_KEYS]:
            yield from _iterate_pairs(recorded.get(key), repeated.get(key), f"{place}.{key}".lstrip("."), estimates)
    elif isinstance(recorded, list) and isinstance(repeated, list) and len(recorded) == len(repeated):
        count = len(recorded)
        for k, (left, right) in enumerate(zip(recorded, repeated, strict=True)):
            entry_errors = (_select_error(errors[0], k, count), _select_error(errors[1], k, count))
            yield from _iterate_pairs(left, right, f"{place}[{k}]", entry_errors)
    elif recorded is not None or repeated is not None:
        yield place, recorded, repeated, _compute_allowed(place, errors)


def _select_error(error: Any, k: int, count: int) -> Any:
    """Return the error of entry ``k`` of an array: its own if there is one for each, else the common one."""
    return error[k] if isinstance(error, list) and len(error) == count else error


def _compute_allowed(place: str, errors: Errors) -> tuple[float, float]:
    """Return the allowed relative difference of two values, k (e + e') of eq. RP.1, and the allowed absolute one.

    ``place`` is the path of keys to the values, ``errors`` are their error estimates e and e', of which any may be missing.
    """
    error_sum = sum(error for error in errors if _is_number(error) and error > 0)
    if "log_sensitivity" in place:
        return 5 * error_sum, LOG_SENSITIVITY_TOLERANCE
    return error_sum, 0.0


def _is_equal(recorded: Any, repeated: Any, allowed: tuple[float, float]) -> bool:
    """Return whether two leaves agree: texts and booleans exactly, numbers within the allowed difference."""
    if isinstance(recorded, str) and isinstance(repeated, str):
        return recorded == repeated or _is_same_quantity(recorded, repeated)
    if not (_is_number(recorded) and _is_number(repeated)):
        return bool(recorded == repeated)
    return math.isclose(recorded, repeated, rel_tol=allowed[0] + ROUNDING_RELATIVE, abs_tol=allowed[1])


def _is_same_quantity(recorded: str, repeated: str) -> bool:
    """Return whether two texts are the same quantity up to rounding, such as ``4.31 mm``."""
    left, right = _QUANTITY_PATTERN.fullmatch(recorded), _QUANTITY_PATTERN.fullmatch(repeated)
    if left is None or right is None or left[2] != right[2]:
        return False
    return math.isclose(float(left[1]), float(right[1]), rel_tol=ROUNDING_RELATIVE)


def _format_value(value: object) -> str:
    """Format a value for a message, shortened."""
    return f"{value:.6g}" if isinstance(value, float) else repr(value)[:60]


def _is_number(value: object) -> bool:
    """Return whether a value is a finite number; integers in a damaged file may exceed the range of floats."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max
