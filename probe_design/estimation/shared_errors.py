"""Compute the misfit of data that share errors by uncertain numbers of the scene, eq. ES.7.

If these numbers deviate by eta_j standard deviations, k data change by d(eta), the polynomial of eq. ES.7. The misfit of data y
to predictions m is the minimum over all eta, which are standard normal:

    chi2 = min over eta of sum_i ((y_i - m_i - d_i(eta)) / s_i)^2 + sum_j eta_j^2                  (ES.8)

Here s_i is the noise of datum i. For d = J eta it is r^T W r with r = (y - m) / s, W = (I + A A^T)^-1 and A = J / s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats, Ints

STEPS = 8  # Gauss-Newton steps for eta
LONGEST = 1.0  # standard deviations: largest change of eta in one step


@dataclass(frozen=True)
class SharedErrors:
    """Coefficients of the polynomial of eq. ES.7 for q numbers; q = 0 without nuisances.

    Attributes:
        linear: J, shape (..., k, q).
        quadratic: C, likewise.
        products: coefficients of other products of powers of eta, shape (..., k, n); None where there are none.
        powers: exponent of each eta in these products, shape (n, q).
    """

    line: Floats
    bend: Floats
    more: Floats | None = None
    powers: tuple[tuple[int, ...], ...] = ()

    @classmethod
    def none(cls, k: int) -> SharedErrors:
        """Return the coefficients for k data that share no errors."""
        return cls(np.zeros((k, 0)), np.zeros((k, 0)))

    def over(self, noise: Floats) -> SharedErrors:
        """Return the coefficients divided by the noise of shape (k,)."""
        return self.mapped(lambda part: part / noise[:, None])

    def mapped(self, change: Callable[[Floats], Floats]) -> SharedErrors:
        """Return the errors with a function applied to each array of coefficients."""
        more = None if self.more is None else change(self.more)
        return SharedErrors(change(self.line), change(self.bend), more, self.powers)

    def at(self, eta: Floats) -> Floats:
        """Return the change d of the data, eq. ES.7, shape (..., k), at eta of shape (..., q)."""
        found = _times(self.line, eta) + _times(self.bend, eta**2)
        return found if self.more is None else found + _times(self.more, _products(eta, self._powers))

    def slope(self, eta: Floats) -> Floats:
        """Return the derivatives of d by eta, shape (..., k, q)."""
        found = self.line + 2 * self.bend * eta[..., None, :]
        if self.more is None:
            return np.asarray(found)
        parts = []
        for j, power in enumerate(self._powers.T):
            lower = np.maximum(self._powers - np.eye(self.line.shape[-1], dtype=int)[j], 0)
            parts.append(_times(self.more, power * _products(eta, lower)))
        return np.asarray(found + np.stack(parts, axis=-1))

    @property
    def _powers(self) -> Ints:
        return np.array(self.powers, dtype=int)

    def decorrelated(self, values: Floats) -> Floats:
        """Return W v, with W of eq. ES.8, for values v divided by the noise, shape (..., k)."""
        return values - _times(self.line, self._solved(self.line, _times(_turned(self.line), values)))

    def misfit(self, off: Floats) -> Floats:
        """Return chi2 of eq. ES.8 for differences y - m divided by the noise, shape (..., k)."""
        if not self.line.shape[-1]:
            return np.asarray((off**2).sum(axis=-1))
        eta = self._solved(self.line, _times(_turned(self.line), off))
        least = self._at(off, eta)
        for _ in range(STEPS):
            tangent = self.slope(eta)
            step = self._solved(tangent, _times(_turned(tangent), off - self.at(eta)) - eta)
            eta = eta + step / np.maximum(1.0, np.abs(step).max(axis=-1, keepdims=True) / LONGEST)
            least = np.minimum(least, self._at(off, eta))
        return least

    def _at(self, off: Floats, eta: Floats) -> Floats:
        """Return the sum of eq. ES.8 at given eta, which the misfit minimises."""
        return np.asarray(((off - self.at(eta)) ** 2).sum(axis=-1) + (eta**2).sum(axis=-1))

    def _solved(self, line: Floats, right: Floats) -> Floats:
        """Solve (I + A^T A) x = right, with A the linear coefficients, shape (..., k, q)."""
        square = np.eye(line.shape[-1]) + _turned(line) @ line
        return np.asarray(np.linalg.solve(square, right[..., None])[..., 0])


def _times(matrix: Floats, vector: Floats) -> Floats:
    return np.asarray((matrix @ vector[..., None])[..., 0])


def _products(eta: Floats, powers: Ints) -> Floats:
    """Return products of powers of eta, shape (..., n)."""
    return np.asarray(np.prod(eta[..., None, :] ** powers, axis=-1))


def _turned(matrix: Floats) -> Floats:
    return np.swapaxes(matrix, -1, -2)
