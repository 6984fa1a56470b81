"""Text from the command line as numbers, refused in one line, and results as JSON; heavy imports wait until they are needed."""

from __future__ import annotations

import json
from typing import Any


def number(key: str, text: str, allowed: str = "a number above 0 and below 1, such as 0.01") -> float:
    """Read a number; whether it is in range is for those to say who use it.

    Raises:
        InputError: it is none.
    """
    from geometry.common.errors import InputError

    try:
        return float(text)
    except ValueError:
        raise InputError(key, text, allowed) from None


def length(key: str, text: str) -> float:
    """Read a length such as ``"5 mm"``, in m."""
    from geometry.scenes.probe import LENGTH

    return quantity(LENGTH, key, text)


def position(key: str, text: str) -> float:
    """Read a position such as ``"-20 mm"``, in m."""
    from typing import get_args

    from geometry.scenes.probe import Position

    return quantity(get_args(Position)[1], key, text)


def modulus(key: str, text: str) -> float:
    """Read a modulus such as ``"1 kPa"``, in Pa."""
    from geometry.scenes.probe import MODULUS

    return quantity(MODULUS, key, text)


def quantity(kind: Any, key: str, text: str) -> float:
    """Read a quantity of a kind of ``geometry.scenes.units``, in SI units.

    Raises:
        InputError: it is none of that kind.
    """
    from geometry.common.errors import InputError

    try:
        return float(kind.parse(text))
    except ValueError as fault:
        raise InputError(key, text, f"{kind.allowed} ({fault})") from None


def print_json(value: dict[str, Any]) -> None:
    """Print one JSON object; NaN and infinity are a defect."""
    print(json.dumps(value, allow_nan=False))
