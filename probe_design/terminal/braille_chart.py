"""Draw curves as text with Unicode Braille patterns, which have two by four dots in each character."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geometry.common.arrays import Floats

BLANK_CODE_POINT = 0x2800
DOT_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])  # bits of the dots, row by row from the top
LABEL_WIDTH = 11  # characters of the labels of the vertical axis


def draw_chart(curves: Sequence[Floats], width: int = 60, height: int = 8) -> str:
    """Return a chart of curves as ``height`` lines of text; the values of a curve are evenly spaced.

    Parameters
    ----------
    curves
        Each of shape (n,), n >= 1; a curve may be longer or shorter than the others.
    width
        Characters, axis included.
    height
        lines.
    """
    columns = max(2 * (width - LABEL_WIDTH - 1), 2)
    low, high = min(float(line.min()) for line in curves), max(float(line.max()) for line in curves)
    span = high - low if high > low else max(abs(high), 1e-30)
    grid = np.zeros((4 * height, columns), dtype=bool)
    for curve in curves:
        positions = np.linspace(0, len(curve) - 1, columns)
        values = np.interp(positions, np.arange(len(curve)), curve)
        rows = np.rint((high - values) / span * (4 * height - 1)).astype(int).clip(0, 4 * height - 1)
        for column, (first, last) in enumerate(zip(rows, np.append(rows[1:], rows[-1]), strict=True)):
            grid[min(first, last) : max(first, last) + 1, column] = True
    cells = (grid.reshape(height, 4, columns // 2, 2) * DOT_BITS[:, None, :]).sum(axis=(1, 3))
    labels = [f"{high:.4g}", *[""] * (height - 2), f"{low:.4g}"]
    return "\n".join(
        f"{label:>{LABEL_WIDTH}} " + "".join(chr(BLANK_CODE_POINT + cell) for cell in row)
        for label, row in zip(labels, cells, strict=True)
    )
