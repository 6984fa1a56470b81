"""Elastic fields about a sphere's centre: modes that are regular there, and modes that decay outwards.

In an unbounded isotropic body every displacement that balances is a sum of vector harmonics of degree l: two spheroidal
ones, u = rho^p (a Y e_r + b grad_s Y), and a toroidal one. Lengths are in units of the sphere's radius R, axes are the
sphere's own. In terms of solid harmonics f = rho^l Y (regular) or rho^(-l-1) Y (outgoing), with v = nu:

    kind        regular                                                outgoing
    0 (M3)      grad f, p = l - 1                                      (4-4v-l) rho^2 grad f + (2l+2 + (4l+2)(1-2v)) x f, p = -l
    1 (M4)      (l+5-4v) rho^2 grad f - (2l + (4l+2)(1-2v)) x f,       grad f, p = -l - 2
                p = l + 1; l = 0: x
    2 (M5)      x cross grad f, p = l                                  x cross grad f, p = -l - 1

Each right-hand side is its left one with l -> -l-1; all are polynomials in v, so that nothing degenerates at any l or v
(with a unit grad_s part kind 0 would at l = 4 - 4v). They are scaled to be of order 1 at rho = 1, and such that an
outgoing mode does work on the regular mode of its own kind, l, m and parity only (Betti): the integral over any sphere about
the centre of outgoing traction times regular displacement minus the reverse is -2 mu R ``work``.
Stable up to nu = 0.499999 and degree 30 and beyond.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from geometry.grading import Floats
from solver.harmonics import Harmonics, Side, derivatives
from solver.shapes import Ints

Parity = Literal["even", "both"]
Values = NDArray[Any]  # real, or complex for derivatives by complex steps
VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))  # xx, yy, zz, yz, xz, xy
CYCLES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
EVERY = tuple(range(32))  # sums behind ``_both``
DISPLACEMENT = EVERY[:10]  # those that displacement needs
UPWARD = (9, 10, 11, 12, 17, 16, 15, 23, 22, 21, *range(25, 32))  # those of ``_upward``: of xz, yz, zz in this order
KEPT = 4_000_000  # values of harmonics that a sampler keeps: 32 MB
ALL = slice(None)
BLOCK = 2048  # points at a time: a table of harmonics that stays in the cache
Combine = Callable[[Floats, Values], tuple[Values, ...]]


@dataclass(frozen=True)
class Modes:
    """Which modes, in which matrix. Sorted by (m, sine, l, kind), see ``labels``.

    Attributes:
        degree: largest l.
        nu: the matrix's Poisson ratio, 0 to 0.499999; complex for derivatives by complex steps.
        order: largest m, at most ``degree``; with 0 and "even" the fields are axisymmetric, without torsion.
        parity: "even" for fields that mirror in the local plane y = 0, or "both".
    """

    degree: int
    nu: complex
    order: int
    parity: Parity = "even"

    @cached_property
    def labels(self) -> Ints:
        """Rows kind, l, m and sine (1 where the scalar harmonic is sin m phi), shape (4, modes)."""
        found: list[tuple[int, int, int, int]] = []
        for m in range(min(self.order, self.degree) + 1):
            for sine in (0, 1):
                for ell in range(m, self.degree + 1):
                    found += [(kind, ell, m, sine) for kind in self._kinds(ell, m, sine)]
        return np.array(found).T

    def _kinds(self, ell: int, m: int, sine: int) -> list[int]:
        """Kinds that a scalar harmonic makes; x cross grad turns an even function into an odd field and the reverse."""
        kept = range(3) if self.parity == "both" else [2] if sine else [0, 1]
        return [kind for kind in kept if (m > 0 or not sine) and (ell > 0 or kind == 1)]

    @property
    def kind(self) -> Ints:
        """Kind of each mode, 0, 1 or 2, shape (modes,)."""
        out: Ints = self.labels[0]
        return out

    @property
    def ell(self) -> Ints:
        """Degree of each mode."""
        out: Ints = self.labels[1]
        return out

    @property
    def m(self) -> Ints:
        """Azimuthal order of each mode."""
        out: Ints = self.labels[2]
        return out

    @property
    def partner(self) -> Ints:
        """Place of the other spheroidal mode of the same l, m and parity; a mode's own place where there is none."""
        out: Ints = np.arange(len(self)) + (self.ell > 0) * np.array([1, -1, 0])[self.kind]
        return out

    @property
    def work(self) -> Values:
        """Minus Betti's work of each outgoing mode on its regular mode, in 2 mu R: 1, but 3 (1-nu) / (1-2nu) for l = 0."""
        return np.where(self.ell > 0, 1, 3 * (1 - self.nu) / (1 - 2 * self.nu))

    def __len__(self) -> int:
        return len(self.kind)

    def regular(self, points: Floats, coefficients: Values) -> tuple[Values, Values]:
        """Displacement and stress of sums of regular modes: as ``outgoing``, the centre allowed."""
        return Sampler(self, points, "regular").both(coefficients)

    def outgoing(self, points: Floats, coefficients: Values) -> tuple[Values, Values]:
        """Displacement and stress of sums of outgoing modes.

        Args:
            points: in units of R from the centre, shape (n, 3); not the centre.
            coefficients: shape (modes, k), in m for a field in m.

        Returns:
            Displacement in the coefficients' unit, shape (n, 3, k), and stress xx, yy, zz, yz, xz, xy, shape (n, 6, k), to be
            multiplied by 2 mu / R for Pa.
        """
        return Sampler(self, points, "outgoing").both(coefficients)

    def displacement(self, points: Floats, coefficients: Values, side: Side) -> Values:
        """Displacement alone, shape (n, 3, k), about twice as fast."""
        return Sampler(self, points, side).displacement(coefficients)

    def shapes(self, points: Floats, side: Side) -> Values:
        """Displacement of every mode by itself, shape (n, 3, modes)."""
        table = self.harmonics.table(points, side)
        columns = sp.vstack([_sums(self, side)[row].T for row in DISPLACEMENT], format="csr") @ table
        (out,) = _displacement(points.T, columns.reshape(len(DISPLACEMENT), len(self), -1))
        return np.ascontiguousarray(np.moveaxis(out, -1, 0))

    @cached_property
    def harmonics(self) -> Harmonics:
        """The solid harmonics of which fields and their derivatives are sums: two degrees and orders more, for the stress."""
        return Harmonics(self.degree + 2, min(self.order, self.degree) + 2)


@dataclass(frozen=True)
class Sampler:
    """Sums of modes at points that stay the same: what does not depend on the coefficients is kept, unless it is large.

    Attributes:
        modes, points, side: as ``Modes.outgoing`` takes them.
    """

    modes: Modes
    points: Floats
    side: Side

    def both(self, coefficients: Values, part: slice = ALL) -> tuple[Values, Values]:
        """Displacement and stress, see ``Modes.outgoing``, at some of the points."""
        u, stress = self._combined(coefficients, EVERY, _both, part)
        return u, stress

    def displacement(self, coefficients: Values, part: slice = ALL) -> Values:
        """Displacement alone, shape (n, 3, k)."""
        return self._combined(coefficients, DISPLACEMENT, _displacement, part)[0]

    def upward(self, coefficients: Values, part: slice = ALL) -> Values:
        """Stresses xz, yz, zz / (2 mu / R), which act on planes across z, shape (n, 3, k): a third of the work of ``both``."""
        return self._combined(coefficients, UPWARD, _upward, part)[0]

    def _combined(self, coefficients: Values, rows: tuple[int, ...], combine: Combine, part: slice) -> tuple[Values, ...]:
        size, k = 2 * self.modes.harmonics.count, coefficients.shape[1]
        sums = (_stacked(self.modes, self.side, rows) @ coefficients).reshape(len(rows), size, k)
        narrow = sums.transpose(0, 2, 1).reshape(-1, size)
        low, high, _ = part.indices(len(self.points))
        found = []
        for start in range(low, max(high, low + 1), BLOCK):
            here = slice(start, min(start + BLOCK, high))
            columns = _product(narrow, self._table(here))
            found.append(combine(self.points[here].T, columns.reshape(len(rows), k, -1)))
        return tuple(np.ascontiguousarray(np.moveaxis(np.concatenate(out, axis=-1), -1, 0)) for out in zip(*found, strict=True))

    def _table(self, part: slice) -> Floats:
        if 2 * self.modes.harmonics.count * len(self.points) > KEPT:
            return self.modes.harmonics.table(self.points[part], self.side)
        return self._kept[:, part]

    @cached_property
    def _kept(self) -> Floats:
        return self.modes.harmonics.table(self.points, self.side)


@lru_cache(maxsize=32)
def _stacked(modes: Modes, side: Side, rows: tuple[int, ...]) -> Any:
    """Some of ``_sums`` one below the other."""
    return sp.vstack([_sums(modes, side)[row] for row in rows], format="csr")


@lru_cache(maxsize=16)
def _sums(modes: Modes, side: Side) -> list[Any]:
    """Sparse (harmonics, modes) matrices of the scalar sums that ``_displacement`` and ``_both`` combine."""
    potential, square, radial, cross, pressure = (_spread(modes, row) for row in _potentials(modes, side))
    D = derivatives(modes.harmonics, side)
    first = [[d @ one for d in D] for one in (potential, square, cross, square + radial / 2)]
    second = [[D[i] @ D[j] @ one for i, j in VOIGT] for one in (potential, square, cross)]
    return [*first[0], *first[1], *first[2], radial, *first[3], *second[0], *second[1], *second[2], pressure]


def _spread(modes: Modes, factors: Values) -> Any:
    """The sparse matrix from modes to coefficients of their scalar harmonics."""
    h, (_, ell, m, sine) = modes.harmonics, modes.labels
    rows = [h.index(int(a), int(b)) + int(s) * h.count for a, b, s in zip(ell, m, sine, strict=True)]
    return sp.csr_array((factors, (rows, np.arange(len(modes)))), shape=(2 * h.count, len(modes)))


def _potentials(modes: Modes, side: Side) -> Values:
    """Factors of each mode in P, V, W, Z of ``_displacement`` and in H = nu / (1-2nu) div u, shape (5, modes)."""
    (kind, ell, _, _), nu = modes.labels, modes.nu
    rows: Values = np.zeros((5, len(modes)), np.result_type(nu, float))
    lone, pair, curl = (np.where(kind == k, scales(ell, nu, side)[k], 0) for k in range(3))
    n, gradient, other = (ell, lone, pair) if side == "regular" else (-ell - 1, pair, lone)
    rows[0], rows[3] = gradient, curl
    rows[1], rows[2] = (n + 5 - 4 * nu) * other, -(2 * n + (4 * n + 2) * (1 - 2 * nu)) * other
    rows[4] = -2 * nu * (n + 1) * (2 * n + 3) * other  # div u has the factor 1 - 2 nu
    rows[:, ell == 0] = np.array([[0, 0, 1, 0, 3 * nu / (1 - 2 * nu)] if side == "regular" else [-1, 0, 0, 0, 0]]).T
    return rows


def scales(ell: Ints, nu: complex, side: Side) -> tuple[Values, Values, Values]:
    """Factors of the fields (M3), (M4) and (M5) in the modes of degrees l > 0 (for l = 0 they mean nothing).

    Gradients have unit mean square times 4 pi at rho = 1; the other factors then make ``work`` 1.
    """
    ell = np.maximum(ell, 1)
    inner, outer = np.sqrt(ell * (2 * ell + 1)), np.sqrt((ell + 1) * (2 * ell + 1))
    curl = np.sqrt(2 / (ell * (ell + 1) * (2 * ell + 1)))
    if side == "regular":
        return 1 / inner, 1 / (outer * (4 * ell + 6) * (1 - nu)), curl
    return 1 / (inner * (4 * ell - 2) * (1 - nu)), 1 / outer, curl


def _product(narrow: Values, table: Floats) -> Values:
    """Product narrow @ table, family by family: where fields mirror, every sum has harmonics of one family only."""
    half = narrow.shape[1] // 2
    out = np.zeros((len(narrow), table.shape[1]), narrow.dtype)
    for family in (slice(0, half), slice(half, None)):
        rows = np.flatnonzero(np.any(narrow[:, family] != 0, axis=1))
        if len(rows):
            out[rows] += narrow[rows, family] @ table[family]
    return out


def _displacement(x: Floats, sums: Values) -> tuple[Values]:
    """Sums (10, k, n) combined to u = grad P + rho^2 grad V + x W + x cross grad Z, shape (3, k, n)."""
    square = np.sum(x**2, axis=0)
    u = sums[0:3] + square * sums[3:6]
    for i, j, k in CYCLES:
        u[i] += x[i] * sums[9] + x[j] * sums[6 + k] - x[k] * sums[6 + j]
    return (u,)


def _both(x: Floats, sums: Values) -> tuple[Values, Values]:
    """Displacement and stress / (2 mu) = strain + nu / (1-2nu) tr strain, from sums (32, k, n).

    Eq. (M6): strain_ij = P_ij + rho^2 V_ij + x_i G_j + x_j G_i + delta_ij W + (T_ij + T_ji) / 2, G = grad (V + W / 2),
    T_ij = (x cross grad Z_j)_i, indices after a scalar being its derivatives.
    """
    (u,) = _displacement(x, sums)
    square = np.sum(x**2, axis=0)
    G, V, Z = sums[10:13], sums[19:25], sums[25:31]
    stress = sums[13:19] + square * V
    isotropic = sums[9] + sums[31]
    for row, (i, j) in enumerate(VOIGT):
        stress[row] += 2 * x[i] * G[i] + isotropic if i == j else x[i] * G[j] + x[j] * G[i]
        stress[row] += _turned(x, Z, i, j) if i == j else (_turned(x, Z, i, j) + _turned(x, Z, j, i)) / 2
    return u, stress


def _upward(x: Floats, sums: Values) -> tuple[Values]:
    """Rows xz, yz, zz of eq. (M6) from the sums ``UPWARD``, shape (3, k, n)."""
    G, Z, square = sums[1:4], sums[10:16], np.sum(x**2, axis=0)
    stress = sums[4:7] + square * sums[7:10]
    for row, i in enumerate((0, 1)):
        stress[row] += x[i] * G[2] + x[2] * G[i] + (_turned(x, Z, i, 2) + _turned(x, Z, 2, i)) / 2
    stress[2] += 2 * x[2] * G[2] + sums[0] + sums[16] + _turned(x, Z, 2, 2)
    return (stress,)


def _turned(x: Floats, second: Values, i: int, j: int) -> Values:
    """T_ij of eq. (M6)."""
    _, a, b = CYCLES[i]
    out: Values = x[a] * second[_place(b, j)] - x[b] * second[_place(a, j)]
    return out


def _place(i: int, j: int) -> int:
    return VOIGT.index((min(i, j), max(i, j)))
