"""One-dimensional node distributions graded towards features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Feature:
    """An interval [low, high] near which cells are no larger than ``growth * (rate * distance + size)``."""

    low: float
    high: float
    size: float
    rate: float = 1.0

    @classmethod
    def point(cls, at: float, size: float, rate: float = 1.0) -> Feature:
        """Return a feature at one point."""
        return cls(at, at, size, rate)

    def cell_size(self, x: Floats) -> Floats:
        """Cell size per unit growth at the points ``x``."""
        return self.rate * np.maximum(np.maximum(self.low - x, x - self.high), 0.0) + self.size


def graded(breaks: Sequence[float], features: Sequence[Feature], growth: float) -> Floats:
    """Return increasing nodes on ``breaks[0] .. breaks[-1]`` that contain every break exactly.

    Cells follow h(x) = growth * min over features of (rate * distance + size) by equidistributing the
    integral of 1/h between consecutive breaks, so their number grows with the logarithm of the scales.
    """
    pieces = [_piece(low, high, features, growth)[:-1] for low, high in pairwise(breaks)]
    return np.concatenate([*pieces, [breaks[-1]]])


def with_midpoints(nodes: Floats) -> Floats:
    """Return the nodes with the middle of every cell between them, shape (2 n - 1,)."""
    out = np.empty(2 * len(nodes) - 1)
    out[::2], out[1::2] = nodes, (nodes[:-1] + nodes[1:]) / 2
    return out


def _piece(low: float, high: float, features: Sequence[Feature], growth: float) -> Floats:
    x = _samples(low, high, features)
    density = 1.0 / (growth * np.min([feature.cell_size(x) for feature in features], axis=0))
    count = np.concatenate([[0.0], np.cumsum(np.diff(x) * (density[1:] + density[:-1]) / 2)])
    cells = max(1, int(np.ceil(count[-1])))
    nodes = np.interp(np.linspace(0.0, count[-1], cells + 1), count, x)
    nodes[0], nodes[-1] = low, high
    return nodes


def _samples(low: float, high: float, features: Sequence[Feature]) -> Floats:
    """Points that resolve every feature: geometric steps of 10 % away from it."""
    length = high - low
    points = [np.linspace(low, high, 33)]
    for feature in features:
        scale = min(feature.size, length)
        steps = scale * np.expm1(np.arange(0.0, np.log1p(length / scale) + 0.1, 0.1))
        points += [end + sign * steps for end in (feature.low, feature.high, low, high) for sign in (-1.0, 1.0)]
    x = np.unique(np.concatenate(points))
    return np.concatenate([[low], x[(x > low) & (x < high)], [high]])
