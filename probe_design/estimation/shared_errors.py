"""Errors that all data share, as some numbers of the scene are known only roughly: the statistics of eq. ES.7.

With such numbers eta_j standard deviations off, k data move by d(eta), the polynomial of eq. ES.7. The misfit of data y to
predictions m is then the least over all eta, which are normal themselves:

    chi2 = min over eta of sum_i ((y_i - m_i - d_i(eta)) / s_i)^2 + sum_j eta_j^2                  (ES.8)

Where d = J eta that is r^T W r with r = (y - m) / s, W = (I + A A^T)^-1 and A = J / s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats, Ints

STEPS = 8  # of Gauss and Newton for eta
LONGEST = 1.0  # standard deviations: a step of them


@dataclass(frozen=True)
class SharedErrors:
    """The polynomial of eq. ES.7, for q numbers; q = 0 where all is known.

    Attributes:
        line: J, shape (..., k, q).
        bend: C, likewise.
        more: coefficients of other products of powers of eta, shape (..., k, n); None where there are none.
        powers: of each eta in these, shape (n, q).
    """

    line: Floats
    bend: Floats
    more: Floats | None = None
    powers: tuple[tuple[int, ...], ...] = ()

    @classmethod
    def none(cls, k: int) -> SharedErrors:
        """Return those of k data that share none."""
        return cls(np.zeros((k, 0)), np.zeros((k, 0)))

    def over(self, noise: Floats) -> SharedErrors:
        """Return them over the noise of shape (k,)."""
        return self.mapped(lambda part: part / noise[:, None])

    def mapped(self, change: Callable[[Floats], Floats]) -> SharedErrors:
        """Return them with all coefficients changed alike."""
        more = None if self.more is None else change(self.more)
        return SharedErrors(change(self.line), change(self.bend), more, self.powers)

    def at(self, eta: Floats) -> Floats:
        """Return d of eq. ES.7, shape (..., k), at eta of shape (..., q)."""
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
        """Return W v of eq. ES.8 for values v over the noise, shape (..., k)."""
        return values - _times(self.line, self._solved(self.line, _times(_turned(self.line), values)))

    def misfit(self, off: Floats) -> Floats:
        """Return eq. ES.8 for differences y - m over the noise, shape (..., k)."""
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
        return np.asarray(((off - self.at(eta)) ** 2).sum(axis=-1) + (eta**2).sum(axis=-1))

    def _solved(self, line: Floats, right: Floats) -> Floats:
        square = np.eye(line.shape[-1]) + _turned(line) @ line
        return np.asarray(np.linalg.solve(square, right[..., None])[..., 0])


def _times(matrix: Floats, vector: Floats) -> Floats:
    return np.asarray((matrix @ vector[..., None])[..., 0])


def _products(eta: Floats, powers: Ints) -> Floats:
    """Return products of powers of eta, shape (..., n)."""
    return np.asarray(np.prod(eta[..., None, :] ** powers, axis=-1))


def _turned(matrix: Floats) -> Floats:
    return np.swapaxes(matrix, -1, -2)
