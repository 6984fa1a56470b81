"""Compute the closed form's constant tables, which are stored so that evaluating a scene needs no SciPy.

Usage: ``python -m benchmarks.closed_form.tables``. Writes ``solver/closed_form/bessel.npy`` anew and prints the coefficients of
``solver/closed_form/half_space.py``.

Duration: seconds.
"""

from __future__ import annotations

import numpy as np
from scipy.special import hyp2f1

from geometry.common.arrays import Floats
from solver.closed_form.bessel import STORED_ORDERS, STORED_VALUES_FILE, compute_table_values
from solver.closed_form.half_space import LOG_COEFFICIENTS, LOG_OFFSET, SMOOTH_COEFFICIENTS


def half_space_coefficients(c: int) -> tuple[Floats, Floats]:
    """Return the powers of 1 - m that make up 2F1(c - 3/2, -1/2; c; m), smooth and singular, exact at m = 1."""
    positions = (1 - np.cos(np.linspace(0, np.pi, 400))) / 2
    values = hyp2f1(c - 1.5, -0.5, c, 1 - positions)
    smooth, singular = SMOOTH_COEFFICIENTS.shape[1], LOG_COEFFICIENTS.shape[1]
    powers = positions[:, None] ** np.arange(1, smooth)
    logs = (positions**2 * np.log(positions + LOG_OFFSET))[:, None] * positions[:, None] ** np.arange(singular)
    fit = np.linalg.lstsq(np.hstack([powers, logs]), values - values[0], rcond=None)[0]
    return np.concatenate([values[:1], fit[: smooth - 1]]), fit[smooth - 1 :]


def main() -> None:
    """Write and print."""
    np.save(STORED_VALUES_FILE, [[compute_table_values(kind, order) for order in range(STORED_ORDERS)] for kind in range(2)])
    for name, rows in zip(
        ("SMOOTH_COEFFICIENTS", "LOG_COEFFICIENTS"), zip(*map(half_space_coefficients, (2, 3)), strict=True), strict=True
    ):
        print(name, *(row.tolist() for row in rows), sep="\n")


if __name__ == "__main__":
    main()
