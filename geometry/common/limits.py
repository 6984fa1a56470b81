"""Limits as text: a limit that a refusal prints is itself allowed, so it is rounded into what is allowed, never out of it."""

from __future__ import annotations

from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal

DIGITS = 6  # as ``:g`` has them


def least(value: float, digits: int = DIGITS) -> str:
    """Write the least that is allowed: rounded up to so many digits.

    Example:
        >>> least(0.010067, 2)
        '0.011'
    """
    return _text(Decimal(repr(float(value))), ROUND_CEILING, digits)


def most(value: float, digits: int = DIGITS) -> str:
    """Write the most that is allowed: rounded down to so many digits.

    Example:
        >>> most(0.010067, 2)
        '0.01'
    """
    return _text(Decimal(repr(float(value))), ROUND_FLOOR, digits)


def least_mm(length: float) -> str:
    """Write the least length (m) that is allowed, in mm: ``5 mm``; see ``reaches`` for how lengths are compared."""
    return f"{_text(_millimetres(length), ROUND_CEILING, DIGITS)} mm"


def most_mm(length: float) -> str:
    """Write the largest length (m) that is allowed, in mm."""
    return f"{_text(_millimetres(length), ROUND_FLOOR, DIGITS)} mm"


def reaches(size: float, limit: float) -> bool:
    """Whether ``size`` is at least ``limit``, but for the rounding by which "10.2 mm" and twice "5.1 mm" may differ."""
    return size >= limit - 1e-12 * abs(limit)


def _millimetres(length: float) -> Decimal:
    """The length without the rounding that ``reaches`` does not see either: twice "5.1 mm" is 10.2 mm."""
    return Decimal(f"{length * 1e3:.12g}")


def _text(value: Decimal, rounding: str, digits: int) -> str:
    return f"{float(Context(prec=digits, rounding=rounding).plus(value)):.{digits}g}"
