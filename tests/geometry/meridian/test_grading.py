"""Cells graded along a line, and the smooth smallest and largest of lengths."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from geometry.meridian.grading import count_folds, grade_nodes, smooth_max, smooth_min
from tests.support.meridian_sections import draw_between, many_examples

sizes = st.tuples(*[st.none() | draw_between(1e-5, 1e2)] * 2)  # of cells at the ends, in the length between these


def density(x: float, length: float, low: float | None, high: float | None) -> float:
    """The integrand of eq. ME.2."""
    return sum(1 / (distance + size) for distance, size in ((x, low), (length - x, high)) if size is not None)


@many_examples
@given(st.floats(-10, 10), draw_between(1e-6, 1e6), st.integers(1, 40), sizes)
def test_cells_have_equal_shares_of_the_integral(start: float, length: float, cells: int, ends: tuple[Any, Any]) -> None:
    low, high = start * length, start * length + length
    a, b = (None if size is None else size * length for size in ends)
    x = grade_nodes(low, high, cells, a, b)
    assert (x[0], x[-1], x.shape) == (low, high, (cells + 1,))
    assert np.all(np.diff(x) > 0)
    if a is None and b is None:
        np.testing.assert_allclose(np.diff(x), length / cells, rtol=1e-10)
        return
    shares = [quad(density, *cell, (length, a, b), epsabs=0)[0] for cell in zip(x - low, x[1:] - low, strict=False)]
    np.testing.assert_allclose(shares, count_folds(low, high, a, b) / cells, rtol=1e-6)


@given(st.lists(draw_between(1e-9, 1e9), min_size=1, max_size=8))
def test_smooth_min_is_close_below(lengths: list[float]) -> None:
    min_length = min(lengths)
    assert min_length / math.sqrt(len(lengths)) * (1 - 1e-12) <= smooth_min(*lengths) <= min_length * (1 + 1e-12)


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), draw_between(1e-3, 1e3))
def test_smooth_max_is_close_above(a: float, b: float, blur: float) -> None:
    excess = smooth_max(a, b, blur) - max(a, b)
    assert -1e-12 * max(abs(a), abs(b)) <= excess <= blur / 2 * (1 + 1e-12) + 1e-12 * max(abs(a), abs(b))
    assert smooth_max(a, b, blur) == smooth_max(b, a, blur)
