"""A limit as it is printed is on the side that is allowed, and no further from the limit than its digits say."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from geometry.common.limits import least, least_mm, most, most_mm, reaches

NUMBERS = st.floats(1e-12, 1e12)


@given(NUMBERS, st.integers(1, 12))
def test_rounded_into_what_is_allowed(value: float, digits: int) -> None:
    low, high = Fraction(most(value, digits)), Fraction(least(value, digits))
    assert low <= Fraction(repr(value)) <= high
    assert high - low <= Fraction(repr(value)) * Fraction(10) ** (1 - digits)


@given(st.floats(1e-9, 10.0))
def test_lengths_stand_for_themselves_but_for_rounding(length: float) -> None:
    low, high = (float(text.removesuffix(" mm")) * 1e-3 for text in (most_mm(length), least_mm(length)))
    assert reaches(length, low)
    assert reaches(high, length)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        (least(0.010067, 2), "0.011"),  # of an accuracy that was printed as 0.01, and then refused
        (most(0.010067, 2), "0.01"),
        (least(0.01), "0.01"),
        (most_mm(2 * (5e-3 + 0.1e-3)), "10.2 mm"),  # the float is 0.010199999999999999
        (least_mm(0.1 + 0.2), "300 mm"),  # 0.30000000000000004
        (least_mm(5.72449012345e-3), "5.7245 mm"),
        (most_mm(5.72449012345e-3), "5.72449 mm"),
        (least(0.0), "0"),
        (least(float("inf")), "inf"),
    ],
)
def test_examples(text: str, wanted: str) -> None:
    assert text == wanted
