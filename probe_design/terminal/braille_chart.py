"""Draw curves as text with Unicode Braille patterns, which have two by four dots in each character."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geometry.common.arrays import Floats

BLANK = 0x2800
DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])  # bits of the dots, row by row from the top
LABEL = 11  # characters of the labels of the vertical axis


def chart(curves: Sequence[Floats], width: int = 60, height: int = 8) -> str:
    """Return a chart of curves as ``height`` lines of text; the values of a curve are evenly spaced.

    Args:
        curves: each of shape (n,), n >= 1; a curve may be longer or shorter than the others.
        width: characters, axis included.
        height: lines.
    """
    columns = max(2 * (width - LABEL - 1), 2)
    low, high = min(float(one.min()) for one in curves), max(float(one.max()) for one in curves)
    span = high - low if high > low else max(abs(high), 1e-30)
    grid = np.zeros((4 * height, columns), dtype=bool)
    for curve in curves:
        at = np.linspace(0, len(curve) - 1, columns)
        values = np.interp(at, np.arange(len(curve)), curve)
        rows = np.rint((high - values) / span * (4 * height - 1)).astype(int).clip(0, 4 * height - 1)
        for column, (first, last) in enumerate(zip(rows, np.append(rows[1:], rows[-1]), strict=True)):
            grid[min(first, last) : max(first, last) + 1, column] = True
    cells = (grid.reshape(height, 4, columns // 2, 2) * DOTS[:, None, :]).sum(axis=(1, 3))
    labels = [f"{high:.4g}", *[""] * (height - 2), f"{low:.4g}"]
    return "\n".join(
        f"{label:>{LABEL}} " + "".join(chr(BLANK + cell) for cell in row) for label, row in zip(labels, cells, strict=True)
    )
