"""Format limits for messages, rounded inwards, so that a limit that a refusal prints is itself allowed."""

from __future__ import annotations

from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal

DEFAULT_DIGITS = 6  # as ``:g`` has them


def format_minimum(value: float, digits: int = DEFAULT_DIGITS) -> str:
    """Format a lower limit, rounded up to ``digits`` significant digits.

    Examples
    --------
    >>> format_minimum(0.010067, 2)
    '0.011'
    """
    return _round_to_text(Decimal(repr(float(value))), ROUND_CEILING, digits)


def format_maximum(value: float, digits: int = DEFAULT_DIGITS) -> str:
    """Format an upper limit, rounded down to ``digits`` significant digits.

    Examples
    --------
    >>> format_maximum(0.010067, 2)
    '0.01'
    """
    return _round_to_text(Decimal(repr(float(value))), ROUND_FLOOR, digits)


def format_minimum_mm(length: float) -> str:
    """Format a lower limit of a length (m) in mm: ``5 mm``; see ``is_at_least`` for the comparison."""
    return f"{_round_to_text(_to_millimetres(length), ROUND_CEILING, DEFAULT_DIGITS)} mm"


def format_maximum_mm(length: float) -> str:
    """Format an upper limit of a length (m) in mm: ``5 mm``."""
    return f"{_round_to_text(_to_millimetres(length), ROUND_FLOOR, DEFAULT_DIGITS)} mm"


def is_at_least(size: float, limit: float) -> bool:
    """Return whether ``size`` >= ``limit``, with a relative tolerance of 1e-12: "10.2 mm" equals twice "5.1 mm"."""
    return size >= limit - 1e-12 * abs(limit)


def _to_millimetres(length: float) -> Decimal:
    """Convert a length (m) to mm with 12 digits, the tolerance of ``is_at_least``."""
    return Decimal(f"{length * 1e3:.12g}")


def _round_to_text(value: Decimal, rounding: str, digits: int) -> str:
    """Format a number rounded to significant digits in a given direction."""
    return f"{float(Context(prec=digits, rounding=rounding).plus(value)):.{digits}g}"
