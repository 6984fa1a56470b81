"""Errors that all data share, as some numbers of the scene are known only roughly: the statistics of eq. ES.7.

With such a number eta_j standard deviations off, k data move by J eta + C eta^2, a parabola for each number. The misfit of
data y to predictions m is then the least over all eta, which are normal themselves:

    chi2 = min over eta of sum_i ((y_i - m_i - (J eta + C eta^2)_i) / s_i)^2 + sum_j eta_j^2          (ES.8)

Where C is left out that is r^T W r with r = (y - m) / s, W = (I + A A^T)^-1 and A = J / s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats

STEPS = 6  # of Gauss and Newton for eta


@dataclass(frozen=True)
class SharedErrors:
    """J and C of eq. ES.8, shapes (..., k, q); q = 0 where all is known."""

    line: Floats
    bend: Floats

    @classmethod
    def none(cls, k: int) -> SharedErrors:
        """Return those of k data that share none."""
        return cls(np.zeros((k, 0)), np.zeros((k, 0)))

    def over(self, noise: Floats) -> SharedErrors:
        """Return them over the noise of shape (k,)."""
        return SharedErrors(self.line / noise[:, None], self.bend / noise[:, None])

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
            tangent = self.line + 2 * self.bend * eta[..., None, :]
            rest = off - _times(self.line, eta) - _times(self.bend, eta**2)
            eta = eta + self._solved(tangent, _times(_turned(tangent), rest) - eta)
            least = np.minimum(least, self._at(off, eta))
        return least

    def _at(self, off: Floats, eta: Floats) -> Floats:
        rest = off - _times(self.line, eta) - _times(self.bend, eta**2)
        return np.asarray((rest**2).sum(axis=-1) + (eta**2).sum(axis=-1))

    def _solved(self, line: Floats, right: Floats) -> Floats:
        square = np.eye(line.shape[-1]) + _turned(line) @ line
        return np.asarray(np.linalg.solve(square, right[..., None])[..., 0])


def _times(matrix: Floats, vector: Floats) -> Floats:
    return np.asarray((matrix @ vector[..., None])[..., 0])


def _turned(matrix: Floats) -> Floats:
    return np.swapaxes(matrix, -1, -2)
