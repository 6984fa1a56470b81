"""Model a record of a sinusoidal load by the load's harmonics, mains lines and drift, and solve the normal equations.

    v(t) = sum_h Re(a_h e^(j 2 pi h f t)) + sum_k Re(m_k e^(j 2 pi k g t)) + sum_l d_l P_l(2 t / T)                      (SI.3)

f is the load's frequency, g that of the mains; a_h and m_k are complex amplitudes of their harmonics h and k, d_l coefficients
of Legendre polynomials P_l; t runs from the middle of the record of length T. All channels share the columns, so that one small
matrix serves all of them. Rows are processed in slices: a record of any length needs the memory of one slice.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hw.common.samples import Floats

SLICE_ROWS = 65_536  # rows of a slice
DRIFT_COEFFICIENTS = 4  # coefficients of the drift polynomial: up to t^3


@dataclass(frozen=True)
class Lines:
    """The columns of the model, eq. SI.3, by their frequencies in Hz.

    Attributes
    ----------
    load
        Frequency f of the load.
    harmonics
        Number of harmonics of f, the fundamental included.
    mains
        Frequency g of the mains, or None.
    hums
        Number of harmonics of g, the fundamental included.
    half
        Half of the record's length, s.
    """

    load: float
    harmonics: int
    mains: float | None
    hums: int
    half: float

    @property
    def frequencies(self) -> Floats:
        """Frequencies of all s sinusoids, Hz, the load's first, shape (s,)."""
        mains = [] if self.mains is None else [k * self.mains for k in range(1, self.hums + 1)]
        return np.array([h * self.load for h in range(1, self.harmonics + 1)] + mains)

    def build_columns(self, t: Floats) -> Floats:
        """Return the model's columns at times t, eq. SI.3, shape (len(t), 2 s + DRIFT_COEFFICIENTS).

        These are cosine and minus sine of each of the s sinusoids in turn, then the polynomials; with the minus sign the
        coefficients are real and imaginary part of the amplitudes.
        """
        turns = 2 * np.pi * np.outer(t, self.frequencies)
        waves = np.stack([np.cos(turns), -np.sin(turns)], axis=2).reshape(len(t), -1)
        return np.hstack([waves, np.polynomial.legendre.legvander(t / self.half, DRIFT_COEFFICIENTS - 1)])

    def compute_derivatives(self, t: Floats, columns: Floats, coefficients: Floats) -> Floats:
        """Return the derivatives of eq. SI.3 with respect to f and, if there are mains, g: shape (2 or 1, len(t), channels)."""
        waves = columns[:, : 2 * len(self.frequencies)].reshape(len(t), -1, 2)
        re, im = coefficients[: 2 * len(self.frequencies)].reshape(-1, 2, coefficients.shape[1]).transpose(1, 0, 2)
        # d/df Re(a e^(j w t)) = 2 pi h t Re(j a e^(j w t)), and Re(j a e^(j w t)) = -im cos + re (-sin)
        orders = np.array([*range(1, self.harmonics + 1), *range(1, self.hums + 1)])[: len(re), None]
        re, im = 2 * np.pi * orders * re, 2 * np.pi * orders * im
        groups = [slice(0, self.harmonics)] + ([] if self.mains is None else [slice(self.harmonics, None)])
        return np.array([t[:, None] * (waves[:, group, 1] @ re[group] - waves[:, group, 0] @ im[group]) for group in groups])


@dataclass(frozen=True)
class Solution:
    """A least-squares solution at given frequencies.

    Attributes
    ----------
    coefficients
        Of the p columns, V, shape (p, channels).
    inverse
        Inverse of the columns' normal matrix, shape (p, p).
    noise
        Covariance of the residuals, V^2, shape (channels, channels).
    step
        Correction of f and, if there are mains, of g, Hz.
    step_sd
        Standard deviations of ``step``, Hz.
    """

    coefficients: Floats
    inverse: Floats
    noise: Floats
    step: Floats
    step_sd: Floats


def solve(lines: Lines, t: Floats, volts: Floats) -> Solution:
    """Fit eq. SI.3 at the frequencies of ``lines``, and compute a Gauss-Newton correction of these.

    Parameters
    ----------
    lines
        The columns.
    t
        (n,) times from the middle of the record, s.
    volts
        (n, channels).
    """
    normal, right = build_normal_equations(lines, t, volts)
    inverse: Floats = np.asarray(np.linalg.inv(normal), dtype=float)
    coefficients = inverse @ right
    residual_products, derivative_products, column_products, gradient = _sum_products(lines, t, volts, coefficients)
    noise = residual_products / max(len(t) - len(inverse), 1)
    noise_variances = np.maximum(np.diag(noise), np.finfo(float).tiny)
    # without the part of a frequency's effect that other coefficients of the columns can imitate
    derivative_products = derivative_products - np.einsum("apc,pq,bqc->abc", column_products, inverse, column_products)
    information = (derivative_products / noise_variances).sum(axis=2)
    step = np.linalg.solve(information, (gradient / noise_variances).sum(axis=1))
    step_variances = np.maximum(np.diag(np.linalg.inv(information)), 0.0)  # rounding may leave less where rows hardly differ
    return Solution(coefficients, inverse, noise, step, np.sqrt(step_variances))


def build_normal_equations(lines: Lines, t: Floats, volts: Floats) -> tuple[Floats, Floats]:
    """Return the columns' products with each other, (p, p), and with ``volts``, (p, channels); arguments as in ``solve``."""
    products = []
    for rows in iterate_slices(len(t)):
        columns = lines.build_columns(t[rows])
        products.append((columns.T @ columns, columns.T @ volts[rows]))
    normal, right = (np.sum(parts, axis=0) for parts in zip(*products, strict=True))
    return normal, right


def _sum_products(lines: Lines, t: Floats, volts: Floats, coefficients: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Sum four products over all rows; parameters as in ``solve`` and ``Solution``.

    With indices c of channels, a and b of frequencies by which the model is differentiated, and p of columns, the products are of

    - residuals with each other, shape (c, c),
    - derivatives with each other, shape (a, b, c),
    - derivatives with columns, shape (a, p, c),
    - derivatives with residuals, shape (a, c).
    """
    sums = []
    for rows in iterate_slices(len(t)):
        columns = lines.build_columns(t[rows])
        residuals, derivatives = volts[rows] - columns @ coefficients, lines.compute_derivatives(t[rows], columns, coefficients)
        of_derivatives = np.einsum("anc,bnc->abc", derivatives, derivatives)
        with_columns = np.einsum("anc,np->apc", derivatives, columns, optimize=True)
        with_residuals = np.einsum("anc,nc->ac", derivatives, residuals)
        sums.append((residuals.T @ residuals, of_derivatives, with_columns, with_residuals))
    residual_products, derivative_products, column_products, gradient = (
        np.sum(parts, axis=0) for parts in zip(*sums, strict=True)
    )
    return residual_products, derivative_products, column_products, gradient


def iterate_slices(rows: int) -> Iterator[slice]:
    """Yield slices of at most SLICE_ROWS rows."""
    return (slice(low, low + SLICE_ROWS) for low in range(0, rows, SLICE_ROWS))


def compute_residual(lines: Lines, t: Floats, volts: Floats, coefficients: Floats) -> Floats:
    """Return the residuals of eq. SI.3, V, of the shape of ``volts``; parameters as in ``solve`` and ``Solution``."""
    return np.concatenate([volts[rows] - lines.build_columns(t[rows]) @ coefficients for rows in iterate_slices(len(t))])
