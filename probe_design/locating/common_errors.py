"""Integrate over what all readings of a scan have in common: gains, the model's errors, and what is not known of the tissue.

Reading k of a channel differs from its prediction by

    r_k = sum_j (a_jk + b_jk s_k) u_j + w_k,   u_j ~ N(0, 1),   w_k ~ N(0, v_k)                         (LO.5)

with the signal s_k of the tumours. Over one of its standard deviations the common error j moves the reading without tumours by
a_jk, and all signals alike by b_jk, relative to them. With x_k = a_k + b_k s_k, one entry for each common error,

    ln L = -1/2 [S - h^T (1 + A)^-1 h + ln det (1 + A) + sum_k ln v_k],
    S = sum_k r_k^2 / v_k,   h = sum_k x_k r_k / v_k,   A = sum_k x_k x_k^T / v_k                       (LO.2)

and the common errors given the tumours are normal with mean (1 + A)^-1 h and covariance (1 + A)^-1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats

CHANNEL_NAMES = ("ratio", "stiffness")


@dataclass(frozen=True)
class CommonErrors:
    """q numbers that all readings have in common, in units of their standard deviation.

    Attributes
    ----------
    names
        Of each, q texts.
    deviations
        Standard deviation of each before the scan, relative: of a logarithm; shape (q,).
    constant
        a_j of LO.5 at each of l loads, for ln ratio and ln stiffness, shape (q, l, 2).
    scale
        b_j of LO.5, shape (q, l, 2).
    """

    names: tuple[str, ...]
    deviations: Floats
    constant: Floats
    scale: Floats

    @classmethod
    def from_channels(cls, name: str, constant: Floats, scale: Floats | float = 0.0) -> CommonErrors:
        """Return an error of either channel, with the standard deviations ``constant`` and ``scale`` at l loads, (l, 2) each."""
        parts = [np.atleast_2d(np.asarray(values, dtype=float)) for values in (constant, scale + 0 * np.asarray(constant))]
        columns = [np.stack([part * [1.0, 0.0], part * [0.0, 1.0]]) for part in parts]
        deviations = np.maximum(*columns).max(axis=(1, 2))
        kept = deviations > 0
        names = tuple(f"{name}_{channel}" for channel, is_kept in zip(CHANNEL_NAMES, kept, strict=True) if is_kept)
        return cls(names, deviations[kept], columns[0][kept], columns[1][kept])

    def join(self, new: CommonErrors) -> CommonErrors:
        """Return these errors followed by new ones."""
        arrays = (np.concatenate([getattr(self, key), getattr(new, key)]) for key in ("deviations", "constant", "scale"))
        return CommonErrors((*self.names, *new.names), *arrays)

    def select(self, indices: list[int]) -> CommonErrors:
        """Return some of the errors."""
        names = tuple(self.names[index] for index in indices)
        return CommonErrors(names, *(getattr(self, key)[indices] for key in ("deviations", "constant", "scale")))

    def __len__(self) -> int:
        """Return the number of errors."""
        return len(self.names)


@dataclass(frozen=True)
class Rows:
    """a and b of LO.5 for k readings, shape (q, k, 2) each."""

    constant: Floats
    scale: Floats

    @classmethod
    def from_errors(cls, errors: CommonErrors, weights: Floats) -> Rows:
        """Return the rows of readings with ``weights`` of the loads, shape (k, l)."""
        return cls(*(np.einsum("kl,qlc->qkc", weights, part) for part in (errors.constant, errors.scale)))

    @property
    def total_constant(self) -> Floats:
        """Standard deviation of all errors of the readings without tumours, shape (k, 2)."""
        return np.asarray(np.sqrt((self.constant**2).sum(axis=0)))

    @property
    def total_scale(self) -> Floats:
        """Standard deviation of all errors of the signals, relative to them, shape (k, 2)."""
        return np.asarray(np.sqrt((self.scale**2).sum(axis=0)))


@dataclass(frozen=True)
class Sums:
    """Eq. LO.2 of n sets of tumours: all that streaming has to store.

    Attributes
    ----------
    matrix
        A: entries (i, j), i <= j, row by row, shape (q (q + 1) / 2, n).
    vector
        h, shape (q, n).
    square
        S, shape (n,).
    log_variance
        Sum of ln v_k, shape (n,).
    """

    matrix: Floats
    vector: Floats
    square: Floats
    log_variance: Floats

    @classmethod
    def from_readings(cls, rows: Rows, residuals: Floats, variance: Floats, signal: Floats) -> Sums:
        """Return the sums over k readings; residuals, variances (inf where nothing is read) and signals (n, k, 2)."""
        n, q = len(residuals), len(rows.constant)
        is_read = np.isfinite(variance[:1]).any(axis=(0, 1))  # a channel that is not read is left out
        residuals, variance, signal = (part[:, :, is_read].reshape(n, -1) for part in (residuals, variance, signal))
        a, b = (part[:, :, is_read].reshape(q, -1) for part in (rows.constant, rows.scale))
        weights = 1 / variance
        weighted = residuals * weights
        first, second = np.triu_indices(q)
        matrix, vector = (a[first] * a[second]) @ weights.T, a @ weighted.T
        if np.any(b):
            scaled = signal * weights
            matrix += (a[first] * b[second] + b[first] * a[second]) @ scaled.T + (b[first] * b[second]) @ (signal * scaled).T
            vector += b @ (signal * weighted).T
        log_variance = np.log(variance, where=np.isfinite(variance), out=np.zeros_like(variance)).sum(axis=1)
        return cls(matrix, vector, np.einsum("nk,nk->n", residuals, weighted), log_variance)

    @classmethod
    def build_impossible(cls, q: int, n: int) -> Sums:
        """Return sums of n sets that cannot be, with infinite squares."""
        return cls(np.zeros((q * (q + 1) // 2, n)), np.zeros((q, n)), np.full(n, np.inf), np.zeros(n))

    def __add__(self, other: Sums) -> Sums:
        """Return the sums over the readings of both."""
        return Sums(
            self.matrix + other.matrix,
            self.vector + other.vector,
            self.square + other.square,
            self.log_variance + other.log_variance,
        )

    def replace(self, columns: object, part: Sums) -> None:
        """Put the sums of some sets in their place."""
        for name in ("matrix", "vector", "square", "log_variance"):
            getattr(self, name)[..., columns] = getattr(part, name)

    def compute_log_likelihood(self) -> Floats:
        """Return ln L of each set up to a constant that is the same for all tumours; -inf for infinite squares. Shape (n,)."""
        explained, log_determinant = self._eliminate()
        return np.asarray(-(self.square - explained + log_determinant + self.log_variance) / 2)

    def compute_misfit(self) -> Floats:
        """Return the squared residuals that the common errors do not explain, r^T C^-1 r, shape (n,)."""
        return np.asarray(self.square - self._eliminate()[0])

    def solve(self) -> tuple[Floats, Floats]:
        """Return mean and covariance of the common errors given each set of tumours, shapes (n, q) and (n, q, q)."""
        q, n = self.vector.shape
        first, second = np.triu_indices(q)
        matrix = np.zeros((n, q, q))
        matrix[:, first, second] = matrix[:, second, first] = self.matrix.T
        covariance = np.linalg.inv(matrix + np.eye(q))
        return np.asarray(np.einsum("nij,jn->ni", covariance, self.vector)), np.asarray(covariance)

    def _eliminate(self) -> tuple[Floats, Floats]:
        """Return h^T (1 + A)^-1 h and ln det (1 + A) by Gaussian elimination of all sets at once, shape (n,) each.

        Loops over entries, not over sets: with few common errors it is many times faster than a solver for stacked matrices.
        """
        q, n = self.vector.shape
        first, second = np.triu_indices(q)
        entries = {(i, j): self.matrix[k] for k, (i, j) in enumerate(zip(first.tolist(), second.tolist(), strict=True))}
        vector, explained, log_determinant = list(self.vector), np.zeros(n), np.zeros(n)
        for i in range(q):
            pivot = 1 + entries[i, i]
            explained += vector[i] ** 2 / pivot
            log_determinant += np.log(pivot)
            for j in range(i + 1, q):
                factor = entries[i, j] / pivot
                vector[j] = vector[j] - factor * vector[i]
                for k in range(j, q):
                    entries[j, k] = entries[j, k] - factor * entries[i, k]
        return explained, log_determinant
