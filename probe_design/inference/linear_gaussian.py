"""Linear readings of Gaussian unknowns: their covariance, and what they determine of the unknowns.

Readings y depend on unknowns x with Gaussian priors, and have independent errors e,

    y = J x + e,   x_j ~ N(0, p_j^2),   e_i ~ N(0, v_i),   C = V + J P J^T                          (LG.1)

where C is the covariance of the readings, V the diagonal matrix of the v_i, and P that of the p_j^2. An error that readings
share, such as a gain or the error of a baseline reading, is an unknown like any other. An unknown with p_j = 0 is known; of one
with p_j = inf nothing is known before the readings.

All results follow from one orthogonalisation,

    [V^-1/2 J; P^-1/2] D = Q R                                                                      (LG.2)

with orthonormal columns Q, a triangular matrix R, and scales D which make the columns of the left side as large as 1. With w
the part of the vector [V^-1/2 y; 0] that is orthogonal to Q,

    D R^-1 R^-T D = posterior covariance of x,     w . w = y^T C^-1 y                                (LG.3)

which is the squared deflection of a signal y, and the misfit chi-square of a residual y. Large and small priors, or noise, thus
never leave the difference of two large numbers. No product conjugates a complex number, unlike LAPACK's QR: complex steps
differentiate all results.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.common.errors import InputError

Array = NDArray[Any]  # of floats, or of complex numbers on the way to a derivative
_RELATIVE_ROUNDING = float(np.finfo(float).eps)  # times the number of terms of a sum


@dataclass(frozen=True)
class LinearGaussian:
    """Linear readings of Gaussian unknowns, eq. LG.1; leading axes of all arrays are a batch and broadcast.

    Attributes
    ----------
    derivatives
        J, of m readings with respect to q unknowns, shape (..., m, q).
    variance
        v, of the independent errors, shape (..., m).
    prior_sd
        p, from 0 to inf, shape (..., q).

    Raises
    ------
    InputError
        A variance is not above 0, or a prior standard deviation is below 0. NaN is passed on to the results.
    """

    derivatives: Array
    variance: Array
    prior_sd: Array

    def __post_init__(self) -> None:
        """Refuse readings without noise."""
        if np.any(np.real(self.variance) <= 0):
            raise InputError("variance", float(np.real(self.variance).min()), "a variance above 0 of each reading")
        if np.any(self.prior_sd < 0):
            raise InputError("prior_sd", float(np.min(self.prior_sd)), "a standard deviation from 0 to inf")

    @classmethod
    def from_shared_errors(cls, shared: Array, variance: Array) -> LinearGaussian:
        """Return readings with errors that they share and errors of their own.

        Parameters
        ----------
        shared
            Change of the m readings by one standard deviation of each of q shared errors, shape (..., m, q).
        variance
            Variances of the independent errors, shape (..., m).
        """
        return cls(shared, variance, np.ones(shared.shape[-1]))

    def add_unknowns(self, derivatives: Array, prior_sd: Array) -> LinearGaussian:
        """Return the model with further unknowns, which come first.

        Parameters
        ----------
        derivatives
            Derivatives of the readings with respect to the k further unknowns, shape (..., m, k).
        prior_sd
            Prior standard deviations of these, from 0 to inf, shape (..., k).
        """
        columns, sds = (derivatives, self.derivatives), (np.asarray(prior_sd), self.prior_sd)
        batch = np.broadcast_shapes(*(part.shape[:-2] for part in columns), *(part.shape[:-1] for part in sds))
        joined = np.concatenate([np.broadcast_to(part, (*batch, *part.shape[-2:])) for part in columns], axis=-1)
        return LinearGaussian(
            joined, self.variance, np.concatenate([np.broadcast_to(part, (*batch, part.shape[-1])) for part in sds], axis=-1)
        )

    @property
    def covariance(self) -> Array:
        """C of eq. LG.1, shape (..., m, m); all priors have to be finite."""
        shared_deviations = self.derivatives * self.prior_sd[..., None, :]
        white = self.variance[..., None] * np.eye(self.variance.shape[-1])
        return np.asarray(white + shared_deviations @ np.swapaxes(shared_deviations, -1, -2))

    def whiten(self, columns: Array) -> Array:
        """Return whitened columns w of eq. LG.3: for columns a and b the product w_a . w_b is a^T C^-1 b.

        ``columns`` have the shape (..., m, c), the result (..., m + q, c).
        """
        return _restore_axes(self._project(columns)[0])

    def compute_information(self, derivatives: Array) -> Array:
        """Return the Fisher information J^T C^-1 J, shape (..., c, c), of other unknowns with derivatives (..., m, c)."""
        w = self._project(derivatives)[0]
        return _restore_axes((w[:, None] * w).sum(axis=2))

    def compute_chi_square(self, values: Array) -> Array:
        """Return y^T C^-1 y, shape (...), for values (..., m): the misfit of a residual, the squared deflection of a signal."""
        return np.asarray((self._project(values[..., None])[0] ** 2).sum(axis=(0, 1)))

    def weigh(self, values: Array) -> Array:
        """Return C^-1 y for values y, shape (..., m)."""
        # the first m rows of w are V^(1/2) C^-1 y
        return np.asarray(self.whiten(values[..., None])[..., : values.shape[-1], 0] / np.sqrt(self.variance))

    def compute_log_likelihood(self, values: Array) -> Array:
        """Return the logarithm of the density N(0, C) at values (..., m), shape (...); all priors have to be finite."""
        # ln density = -(y^T C^-1 y + ln det(2 pi V)) / 2 - ln(det C / det V) / 2
        chi_square, log_det_white = self.compute_chi_square(values), np.log(2 * np.pi * self.variance).sum(axis=-1)
        return np.asarray(-(chi_square + log_det_white) / 2 - self.compute_half_log_determinant())

    def compute_half_log_determinant(self) -> Array:
        """Return ln(det C / det V) / 2, shape (...): the information of the readings about all unknowns, nats; priors are finite.

        That of a model with more unknowns, less that without them, is the information about these.
        """
        # from the diagonals of R and of P^-1/2 D, the rows of the priors in eq. LG.2
        factors = self._factors
        total = sum((np.log(factors.R[k, k] / factors.prior_rows[k]) for k in range(len(factors.R))), np.zeros(self._batch))
        return np.asarray(total)

    def compute_posterior_mean(self, values: Array) -> Array:
        """Return the mean of the unknowns after readings (..., m), shape (..., q); the prior's where these determine nothing."""
        mean = self._project(values[..., None])[1][:, 0]
        R, scale = _align_batch(self._factors.R, 2, mean.ndim - 1), _align_batch(self._factors.scale, 1, mean.ndim - 1)
        for k in reversed(range(len(mean))):  # back substitution: R mean = Q^T [V^-1/2 y; 0]
            mean[k] = (mean[k] - (R[k, k + 1 :] * mean[k + 1 :]).sum(axis=0)) * _invert(R[k, k])
        return np.moveaxis(mean * scale, 0, -1)

    def compute_posterior_sd(self, combination: Array) -> Array:
        """Return the standard deviation of c . x after the readings, shape (...); inf where these do not determine it.

        Parameters
        ----------
        combination
            Coefficients c of the first k unknowns, shape (..., k); those of the others are 0.
        """
        padding = [(0, 0)] * (combination.ndim - 1) + [(0, self.derivatives.shape[-1] - combination.shape[-1])]
        # |R^-T D c| is the standard deviation by eq. LG.3
        root, is_resolved = self._solve_transposed(np.pad(combination, padding)[..., None])
        return np.asarray(np.where(is_resolved, np.sqrt((root**2).sum(axis=0)), np.inf)[0])

    def compute_posterior_covariance(self) -> Array:
        """Return eq. LG.3, shape (..., q, q).

        An unknown that neither prior nor readings determine has an infinite variance, and covariances of NaN.
        """
        root, is_resolved = self._solve_transposed(np.eye(self.derivatives.shape[-1]))
        covariance = _restore_axes((root[:, :, None] * root[:, None]).sum(axis=0))
        both = _restore_axes(is_resolved[:, None] & is_resolved)
        return np.where(both, covariance, np.where(np.eye(covariance.shape[-1]) > 0, np.inf, np.nan))

    @property
    def _batch(self) -> tuple[int, ...]:
        """Shape of the leading axes of all arrays, broadcast."""
        return np.broadcast_shapes(self.derivatives.shape[:-2], self.variance.shape[:-1], self.prior_sd.shape[:-1])

    @cached_property
    def _factors(self) -> _Factors:
        """Q, R and D of eq. LG.2, by modified Gram-Schmidt."""
        (m, q), batch = self.derivatives.shape[-2:], self._batch
        noise_sd, prior_sd = (
            np.moveaxis(np.broadcast_to(part, (*batch, part.shape[-1])), -1, 0)
            for part in (np.sqrt(self.variance), self.prior_sd)
        )
        Q = np.zeros((q, m + q, *batch), dtype=np.result_type(self.derivatives, noise_sd, float))
        np.divide(_put_batch_last(np.broadcast_to(self.derivatives, (*batch, m, q))), noise_sd, out=Q[:, :m])
        column_size = np.abs(Q).max(axis=1, initial=0.0)
        scale = np.minimum(
            prior_sd,
            np.divide(1.0, column_size, out=np.full(column_size.shape, np.inf), where=column_size > np.finfo(float).tiny),
        )
        scale = np.where(np.isinf(scale), 1.0, scale)  # of an unknown that neither prior nor readings determine
        prior_rows = np.divide(scale, prior_sd, out=np.ones(scale.shape), where=prior_sd > 0)
        Q *= scale[:, None]
        Q[range(q), range(m, m + q)] = prior_rows
        R = np.zeros((q, q, *batch), dtype=Q.dtype)
        for k, column in enumerate(Q):
            length = np.sqrt((column**2).sum(axis=0))
            # 0 within rounding: the column depends on those before it
            R[k, k] = np.where(length.real <= _RELATIVE_ROUNDING * len(column), 0.0, length)
            column *= _invert(R[k, k])
            for j in range(k + 1, q):
                R[k, j] = (column * Q[j]).sum(axis=0)
                Q[j] -= R[k, j] * column
        return _Factors(Q, R, scale, prior_rows)

    def _project(self, columns: Array) -> tuple[Array, Array]:
        """Split columns [V^-1/2 y; 0] into the part along Q and the part w orthogonal to it, eq. LG.3.

        Parameters
        ----------
        columns
            Columns y, shape (..., m, c).

        Returns
        -------
        tuple[Array, Array]
            w, shape (c, m + q, ...), and the coefficients Q^T [V^-1/2 y; 0], shape (q, c, ...).
        """
        m, batch = columns.shape[-2], np.broadcast_shapes(columns.shape[:-2], self._batch)
        Q = _align_batch(self._factors.Q, 2, len(batch))
        w = np.zeros((columns.shape[-1], Q.shape[1], *batch), dtype=np.result_type(columns, Q))
        w[:, :m] = _align_batch(_put_batch_last(columns), 2, len(batch))
        w[:, :m] /= _align_batch(np.moveaxis(np.sqrt(self.variance), -1, 0), 1, len(batch))
        coefficients = np.zeros((len(Q), len(w), *batch), dtype=w.dtype)
        for k, column in enumerate(Q):
            coefficients[k] = (column * w).sum(axis=1)
            w -= coefficients[k][:, None] * column
        return w, coefficients

    def _solve_transposed(self, columns: Array) -> tuple[Array, Array]:
        """Solve R^T z = D c of eq. LG.2 by forward substitution; |z| is then the posterior standard deviation of c . x, eq. LG.3.

        Parameters
        ----------
        columns
            n columns c, shape (..., q, n).

        Returns
        -------
        tuple[Array, Array]
            z, shape (q, n, ...), and whether priors and readings determine c . x, shape (n, ...): a pivot of 0, of an
            undetermined direction, does not matter where the remainder is 0 within rounding.
        """
        R, scale = _align_batch(self._factors.R, 2, columns.ndim - 2), _align_batch(self._factors.scale, 1, columns.ndim - 2)
        right = np.swapaxes(_align_batch(_put_batch_last(columns), 2, scale.ndim - 1), 0, 1) * scale[:, None]
        root, is_resolved = np.zeros(right.shape, dtype=R.dtype), np.ones(right.shape[1:], dtype=bool)
        for k in range(len(R)):  # row k of R^T is column k of R
            terms = R[:k, None, k] * root[:k]
            remainder, largest = right[k] - terms.sum(axis=0), np.abs(right[k]) + np.abs(terms).sum(axis=0)
            is_resolved &= (R[k, k] != 0) | (np.abs(remainder) <= _RELATIVE_ROUNDING * len(R) * largest)
            root[k] = remainder * _invert(R[k, k])
        return root, is_resolved


@dataclass(frozen=True)
class _Factors:
    """Eq. LG.2, with the batch axes last.

    Attributes
    ----------
    Q
        The columns of Q, one in each row, shape (q, m + q, ...).
    R
        The triangular matrix R, shape (q, q, ...).
    scale
        Diagonal of D, shape (q, ...).
    prior_rows
        Diagonal of P^-1/2 D, shape (q, ...).
    """

    Q: Array
    R: Array
    scale: Array
    prior_rows: Array


def _put_batch_last(matrices: Array) -> Array:
    """Return matrices (..., m, c) as an array (c, m, ...), on which loops over columns are several times faster."""
    return np.moveaxis(matrices, (-1, -2), (0, 1))


def _align_batch(array: Array, leading: int, batch_axes: int) -> Array:
    """Insert axes of length 1 after the first ``leading`` axes, so that at least ``batch_axes`` batch axes follow these."""
    missing = max(0, batch_axes - (array.ndim - leading))
    return array.reshape(*array.shape[:leading], *(1,) * missing, *array.shape[leading:])


def _restore_axes(columns: Array) -> Array:
    """Return an array (c, m, ...) as matrices (..., m, c): the inverse of ``_put_batch_last``."""
    return np.moveaxis(columns, (0, 1), (-1, -2))


def _invert(pivot: Array) -> Array:
    """Return the inverse, 0 where the pivot is 0: nothing is known in that direction."""
    return np.where(pivot == 0, 0.0, 1 / np.where(pivot == 0, 1.0, pivot))
