"""Write fractions as percentages, as all output for people does; JSON objects and CSV files keep the fractions."""

from __future__ import annotations

from decimal import Decimal

from geometry.common.limits import format_minimum


def format_percent(fraction: float, digits: int = 2) -> str:
    """Write a fraction as a percentage with ``digits`` significant digits.

    Examples
    --------
    >>> format_percent(0.0123), format_percent(1.234)
    ('1.2 %', '120 %')
    """
    return f"{float(f'{100 * fraction:.{digits}g}'):.{max(digits, 6)}g} %"  # rounded first, so that 120 is not written as 1.2e+02


def format_minimum_percent(fraction: float, digits: int) -> str:
    """Write a lower limit, a fraction, as a percentage that is rounded up to ``digits`` significant digits.

    Examples
    --------
    >>> format_minimum_percent(0.07, 2), format_minimum_percent(0.0123, 2)
    ('7 %', '1.3 %')
    """
    return f"{format_minimum(float(Decimal(repr(float(fraction))) * 100), digits)} %"  # 100 * 0.07 is above 7 in floats
