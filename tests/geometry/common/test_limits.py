"""A limit as it is printed is on the side that is allowed, and no further from the limit than its digits say."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from geometry.common.limits import format_maximum, format_maximum_mm, format_minimum, format_minimum_mm, is_at_least

NUMBERS = st.floats(1e-12, 1e12)


@given(NUMBERS, st.integers(1, 12))
def test_rounded_into_what_is_allowed(value: float, digits: int) -> None:
    low, high = Fraction(format_maximum(value, digits)), Fraction(format_minimum(value, digits))
    assert low <= Fraction(repr(value)) <= high
    assert high - low <= Fraction(repr(value)) * Fraction(10) ** (1 - digits)


@given(st.floats(1e-9, 10.0))
def test_lengths_stand_for_themselves_but_for_rounding(length: float) -> None:
    low, high = (float(text.removesuffix(" mm")) * 1e-3 for text in (format_maximum_mm(length), format_minimum_mm(length)))
    assert is_at_least(length, low)
    assert is_at_least(high, length)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        (format_minimum(0.010067, 2), "0.011"),  # of an accuracy that was printed as 0.01, and then refused
        (format_maximum(0.010067, 2), "0.01"),
        (format_minimum(0.01), "0.01"),
        (format_maximum_mm(2 * (5e-3 + 0.1e-3)), "10.2 mm"),  # the float is 0.010199999999999999
        (format_minimum_mm(0.1 + 0.2), "300 mm"),  # 0.30000000000000004
        (format_minimum_mm(5.72449012345e-3), "5.7245 mm"),
        (format_maximum_mm(5.72449012345e-3), "5.72449 mm"),
        (format_minimum(0.0), "0"),
        (format_minimum(float("inf")), "inf"),
    ],
)
def test_examples(text: str, wanted: str) -> None:
    assert text == wanted
