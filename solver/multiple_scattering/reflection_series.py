"""Estimate the sum of all reflections from the first few by Galerkin's method, with its remainder."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import numpy as np

from geometry.common.arrays import Floats


@dataclass(frozen=True)
class Reflections:
    """Fields c_0 .. c_n of successive reflections at the spheres, eq. MS.8 of ``solve.py``.

    Attributes
    ----------
    fields
        Regular coefficients of the s states about all spheres, (modes, s) each.
    works
        T times the fields, with the work matrix T of the spheres.
    moments
        mu_0 .. mu_2n of eq. MS.8, (s, s) each.
    """

    fields: tuple[Floats, ...]
    works: tuple[Floats, ...]
    moments: tuple[Floats, ...]

    @classmethod
    def begin(cls, field: Floats, work: Floats) -> Reflections:
        """Begin with the incident field, before any reflection."""
        return cls((field,), (work,), (_symmetrise(field.T @ work),))

    def append(self, field: Floats, work: Floats) -> Reflections:
        """Return the series with one more reflection: its ``field`` and ``work``, T times the field."""
        new = _symmetrise(self.works[-1].T @ field), _symmetrise(field.T @ work)
        return Reflections((*self.fields, field), (*self.works, work), (*self.moments, *new))

    def sum_fields(self, weights: Floats) -> Floats:
        """Return the sum over the reflections of c_i times its weights, which are (n + 1, s, k); shape (modes, k)."""
        return sum((c @ a for c, a in zip(self.fields, weights, strict=True)), np.zeros(()))

    @property
    def count(self) -> int:
        """Number of reflections."""
        return len(self.fields) - 1

    @property
    def states(self) -> int:
        """Number of states s."""
        return len(self.moments[0])

    @cached_property
    def galerkin_weights(self) -> Floats:
        """Weights a of c_0 .. c_n (the last 0) in eq. MS.8, shape (n + 1, s, s)."""
        n, s, mu = self.count, self.states, np.array(self.moments)
        A = _build_hankel(mu[:-1] - mu[1:], n)
        # least squares, as successive fields become nearly parallel and A nearly singular
        a = np.linalg.lstsq(A, mu[:n].reshape(-1, s), rcond=1e-12)[0].reshape(n, s, s)
        return np.concatenate([a, np.zeros((1, s, s))])

    @cached_property
    def remainder_weights(self) -> Floats:
        """Weights of the remainder r = c_0 - (1 - R S) c, with c, R and S of eq. MS.7, shape (n + 1, s, s)."""
        return np.concatenate([np.eye(self.states)[None], self.galerkin_weights[:-1]]) - self.galerkin_weights

    @cached_property
    def products(self) -> Floats:
        """Change of the energy products: B^T a of eq. MS.8 plus the remainder's r^T T r, shape (s, s)."""
        s, remainder = self.states, self.remainder_weights.reshape(-1, self.states)
        value = sum((mu @ a for mu, a in zip(self.moments, self.galerkin_weights, strict=False)), np.zeros((s, s)))
        return _symmetrise(value + remainder.T @ _build_hankel(np.array(self.moments), self.count + 1) @ remainder)

    @cached_property
    def correction(self) -> Floats:
        """Difference of ``products`` from c_0^T T c, which includes asymmetry of the reflections; shape (s, s)."""
        works = [_symmetrise(self.works[0].T @ c) @ a for c, a in zip(self.fields, self.galerkin_weights, strict=True)]
        return np.asarray(self.products - np.sum(works, axis=0))

    @cached_property
    def rho(self) -> float:
        """Fraction rho of a field that is reflected back, eq. MS.9: the largest of three ratios of moments, at most 0.9.

        The ratios are of the first two, of the last two, and per reflection of the last and the last but two.
        """
        size = [max(float(np.linalg.norm(moment)), 1e-300) for moment in self.moments]
        return min(0.9, max(size[1] / size[0], sqrt(size[-1] / size[-3]), size[-1] / size[-2]))


def _build_hankel(blocks: Floats, n: int) -> Floats:
    """Build the Hankel matrix (s n, s n) whose block (i, j), (s, s), is ``blocks[i + j]``."""
    i, size = np.arange(n), n * blocks.shape[1]
    return np.asarray(blocks[i[:, None] + i].transpose(0, 2, 1, 3).reshape(size, size))


def _symmetrise(matrix: Floats) -> Floats:
    """Return the symmetric part of a matrix."""
    return np.asarray((matrix + matrix.T) / 2)
