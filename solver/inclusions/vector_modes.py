"""Elastic fields about a sphere's centre: modes that are regular there, and modes that decay outwards.

In an unbounded isotropic body every displacement in equilibrium is a sum of vector harmonics of degree l: two spheroidal
ones, u = rho^p (a Y e_r + b grad_s Y), and a toroidal one. Lengths are in units of the sphere's radius R, axes are the
sphere's own; Y are the surface harmonics, x is the place, rho = |x|, and v is Poisson's ratio nu of the body. In terms of solid
harmonics f = rho^l Y (regular) or rho^(-l-1) Y (outgoing):

    kind  regular                                            outgoing
    0     grad f, p = l - 1                                  (4-4v-l) rho^2 grad f + (2l+2 + (4l+2)(1-2v)) x f, p = -l  (IN.6)
    1     (l+5-4v) rho^2 grad f - (2l + (4l+2)(1-2v)) x f,   grad f, p = -l - 2
          p = l + 1; l = 0: x                                                                                           (IN.7)
    2     x cross grad f, p = l                              x cross grad f, p = -l - 1                                 (IN.8)

Each right-hand side is its left one with l -> -l-1; all are polynomials in v, so that nothing degenerates at any l or v
(with a unit grad_s part kind 0 would at l = 4 - 4v). They are scaled to be of order 1 at rho = 1, and such that an
outgoing mode does work on the regular mode of its own kind, l, m and parity only (Betti): the integral over any sphere about
the centre of outgoing traction times regular displacement minus the reverse is -2 mu R ``work``.
Stable up to nu = 0.499999 and degree 30 and beyond.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp

from geometry.common.arrays import Floats, Ints
from solver.inclusions.mode_sums import (
    FACTOR_COUNT,
    FACTOR_ONE,
    FACTOR_RHO2,
    FACTOR_X,
    FACTOR_Y,
    FACTOR_Z,
    Sampler,
    Stack,
    Table,
    Values,
)
from solver.inclusions.solid_harmonics import Side, SolidHarmonics, build_derivatives
from solver.linalg.workspace import keep_table
from solver.materials.linear import VOIGT_PAIRS

Parity = Literal["even", "both"]
CYCLIC_AXES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
POSITION_FACTORS = (FACTOR_X, FACTOR_Y, FACTOR_Z)  # of x_i among the factors of eq. IN.11
ALL_COMPONENTS = tuple(range(9))  # components
DISPLACEMENT_COMPONENTS = ALL_COMPONENTS[:3]


@dataclass(frozen=True)
class Modes:
    """A set of modes in a matrix, sorted by (m, sine, l, kind), see ``labels``.

    Attributes
    ----------
    degree
        Largest l.
    nu
        The matrix's Poisson ratio, 0 to 0.499999; complex for derivatives by complex steps.
    order
        Largest m, at most ``degree``; with 0 and "even" the fields are axisymmetric, without torsion.
    parity
        "even" for fields that mirror in the local plane y = 0, or "both".
    """

    degree: int
    nu: complex
    order: int
    parity: Parity = "even"

    @cached_property
    def labels(self) -> Ints:
        """Rows kind, l, m and sine (1 where the scalar harmonic is sin m phi), shape (4, modes)."""
        modes: list[tuple[int, int, int, int]] = []
        for m in range(min(self.order, self.degree) + 1):
            for sine in (0, 1):
                for ell in range(m, self.degree + 1):
                    modes += [(kind, ell, m, sine) for kind in self._list_kinds(ell, m, sine)]
        return np.array(modes).T

    def _list_kinds(self, ell: int, m: int, sine: int) -> list[int]:
        """Return the kinds of modes of a scalar harmonic: 0 and 1 are spheroidal, 2 is toroidal, see eqs. IN.6 to IN.8.

        Fields even about y = 0 are spheroidal ones of cosines and toroidal ones of sines, as x cross grad turns even functions
        into odd fields and the reverse. There is no sin 0, and l = 0 has the dilation, kind 1, alone.
        """
        allowed = range(3) if self.parity == "both" else [2] if sine else [0, 1]
        return [kind for kind in allowed if (m > 0 or not sine) and (ell > 0 or kind == 1)]

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
        """Index of the other spheroidal mode of the same l, m and parity; a mode's own index where there is none."""
        out: Ints = np.arange(len(self)) + (self.ell > 0) * np.array([1, -1, 0])[self.kind]
        return out

    @property
    def work(self) -> Values:
        """Minus Betti's work of each outgoing mode on its regular mode over 2 mu R, shape (modes,).

        It is 1, but 3 (1-nu) / (1-2nu) for l = 0.
        """
        return np.where(self.ell > 0, 1, 3 * (1 - self.nu) / (1 - 2 * self.nu))

    def __len__(self) -> int:
        return len(self.kind)

    def evaluate_regular(self, points: Floats, coefficients: Values) -> tuple[Values, Values]:
        """Return displacement and stress of sums of regular modes, as ``evaluate_outgoing`` does; the centre is allowed."""
        return self._compute_fields(points, coefficients, "regular")

    def evaluate_outgoing(self, points: Floats, coefficients: Values) -> tuple[Values, Values]:
        """Return displacement and stress of sums of outgoing modes.

        Parameters
        ----------
        points
            In units of R from the centre, shape (n, 3); not the centre.
        coefficients
            Shape (modes, k), in m for a field in m.

        Returns
        -------
        tuple[Values, Values]
            Displacement in the coefficients' unit, shape (n, 3, k), and stress xx, yy, zz, yz, xz, xy, shape (n, 6, k), to be
            multiplied by 2 mu / R for Pa.
        """
        return self._compute_fields(points, coefficients, "outgoing")

    def _compute_fields(self, points: Floats, coefficients: Values, side: Side) -> tuple[Values, Values]:
        """Return displacement (n, 3, k) and stress (n, 6, k) of sums of regular or outgoing modes."""
        out = self._evaluate(points, coefficients, side, ALL_COMPONENTS)
        return np.ascontiguousarray(out[:, :3]), np.ascontiguousarray(out[:, 3:])

    def evaluate_displacement(self, points: Floats, coefficients: Values, side: Side) -> Values:
        """Return the displacement alone, shape (n, 3, k), three times as fast as with stress."""
        return self._evaluate(points, coefficients, side, DISPLACEMENT_COMPONENTS)

    def _evaluate(self, points: Floats, coefficients: Values, side: Side, components: tuple[int, ...]) -> Values:
        """Return some components of sums of modes, shape (n, components, k)."""
        sampler = Sampler(build_stack(self, side, components), Table(self.harmonics, side, points), slice(0, len(points)))
        return np.moveaxis(sampler.evaluate(coefficients), -1, 0)

    def evaluate_shapes(self, points: Floats, side: Side) -> Values:
        """Return the displacement of each single mode, shape (n, 3, modes)."""
        table, (x, y, z) = self.harmonics.evaluate(points, side), points.T
        terms = build_stack(self, side, DISPLACEMENT_COMPONENTS)
        blocks = [terms.matrix[low : low + len(table)].T @ table for low in range(0, terms.matrix.shape[0], len(table))]
        factors = np.stack([np.ones_like(x), x, y, x * x + y * y + z * z, z])
        out: Values = np.einsum("ajmn,jn->nam", np.reshape(blocks, (3, FACTOR_COUNT, len(self), -1)), factors)
        return out

    @cached_property
    def harmonics(self) -> SolidHarmonics:
        """The solid harmonics of which fields and their derivatives are sums: two degrees and orders more, for the stress."""
        return SolidHarmonics(self.degree + 2, min(self.order, self.degree) + 2)


@keep_table
def build_stack(modes: Modes, side: Side, components: tuple[int, ...]) -> Stack:
    """Build the sums of eq. IN.11 for displacement (components 0 to 2) and stress / (2 mu) (3 to 8: xx, yy, zz, yz, xz, xy)."""
    sums = [row for component in components for row in _build_sums(modes, side)[component]]
    matrix = sp.vstack(sums, format="csr")
    matrix.eliminate_zeros()
    return Stack(matrix, modes.harmonics, side)


@keep_table
def _build_sums(modes: Modes, side: Side) -> list[list[Any]]:
    """Build sparse (harmonics, modes) matrices h_aj of eq. IN.11: for each component a, a list over j.

    By eqs. IN.6 to IN.8 the displacement u is given by sums of solid harmonics: P of those with grad f, V with rho^2 grad f, W
    with x f and Z with x cross grad f. Here x is the place and rho its distance from the centre; indices i, j of P, V, G, Z are
    derivatives. With Poisson's ratio nu, H = nu / (1-2nu) div u, G = V + W / 2 and Kronecker's delta_ij:

        u_i = P_i + rho^2 V_i + x_i W + (x cross grad Z)_i
        strain_ij + delta_ij H = P_ij + rho^2 V_ij + x_i G_j + x_j G_i + delta_ij (W + H) + (T_ij + T_ji) / 2    (IN.9)

    with T_ij = (x cross grad Z_j)_i; the left-hand side is the stress / (2 mu).
    """
    P, V, W, twist, H = (_spread_modes(modes, row) for row in _compute_potentials(modes, side))
    D = build_derivatives(modes.harmonics, side)
    G = [d @ (V + W / 2) for d in D]
    out = [[0 * P for _ in range(FACTOR_COUNT)] for _ in ALL_COMPONENTS]
    for i, u in enumerate(out[:3]):
        u[FACTOR_ONE], u[FACTOR_RHO2] = D[i] @ P, D[i] @ V
        u[POSITION_FACTORS[i]] = u[POSITION_FACTORS[i]] + W
        _add_cross(u, D, twist, i)
    for (i, j), stress in zip(VOIGT_PAIRS, out[3:], strict=True):
        stress[FACTOR_ONE], stress[FACTOR_RHO2] = D[i] @ (D[j] @ P) + (i == j) * (W + H), D[i] @ (D[j] @ V)
        for a, b in ((i, j), (j, i)):
            stress[POSITION_FACTORS[a]] = stress[POSITION_FACTORS[a]] + G[b]
            _add_cross(stress, D, D[b] @ twist / 2, a)
    return out


def _add_cross(row: list[Any], D: Sequence[Any], scalar: Any, i: int) -> None:
    """Add component i of x cross grad of a scalar to the sums over j of eq. IN.11, ``row``; ``D`` are the derivatives."""
    _, j, k = CYCLIC_AXES[i]
    row[POSITION_FACTORS[j]] = row[POSITION_FACTORS[j]] + D[k] @ scalar
    row[POSITION_FACTORS[k]] = row[POSITION_FACTORS[k]] - D[j] @ scalar


def _spread_modes(modes: Modes, factors: Values) -> Any:
    """Build the sparse matrix from modes to coefficients of their scalar harmonics, with given factors (modes,)."""
    h, (_, ell, m, sine) = modes.harmonics, modes.labels
    rows = [h.find_row(int(a), int(b)) + int(s) * h.count for a, b, s in zip(ell, m, sine, strict=True)]
    return sp.csr_array((factors, (rows, np.arange(len(modes)))), shape=(2 * h.count, len(modes)))


def _compute_potentials(modes: Modes, side: Side) -> Values:
    """Return factors of each mode's harmonic in P, V, W, Z of eq. IN.9 and in H = nu / (1-2nu) div u, shape (5, modes).

    Of the two spheroidal kinds one is grad f, the other its companion: for regular modes kinds 0 and 1, for outgoing the reverse.
    """
    (kind, ell, _, _), nu = modes.labels, modes.nu
    rows: Values = np.zeros((5, len(modes)), np.result_type(nu, float))
    kind_0, kind_1, curl = (np.where(kind == k, compute_scales(ell, nu, side)[k], 0) for k in range(3))
    n, gradient, companion = (ell, kind_0, kind_1) if side == "regular" else (-ell - 1, kind_1, kind_0)
    rows[0], rows[3] = gradient, curl
    rows[1], rows[2] = (n + 5 - 4 * nu) * companion, -(2 * n + (4 * n + 2) * (1 - 2 * nu)) * companion
    rows[4] = -2 * nu * (n + 1) * (2 * n + 3) * companion  # div u has the factor 1 - 2 nu
    rows[:, ell == 0] = np.array([[0, 0, 1, 0, 3 * nu / (1 - 2 * nu)] if side == "regular" else [-1, 0, 0, 0, 0]]).T
    return rows


def compute_scales(ell: Ints, nu: complex, side: Side) -> tuple[Values, Values, Values]:
    """Return the factors that scale the fields of eqs. IN.6, IN.7 and IN.8 (kinds 0, 1 and 2) to modes of degrees l > 0.

    For l = 0 they have no meaning.

    Gradients have unit mean square times 4 pi at rho = 1; the other factors then make ``work`` 1.
    """
    ell = np.maximum(ell, 1)  # l = 0 would divide by zero
    inner, outer = np.sqrt(ell * (2 * ell + 1)), np.sqrt((ell + 1) * (2 * ell + 1))
    curl = np.sqrt(2 / (ell * (ell + 1) * (2 * ell + 1)))
    if side == "regular":
        return 1 / inner, 1 / (outer * (4 * ell + 6) * (1 - nu)), curl
    return 1 / (inner * (4 * ell - 2) * (1 - nu)), 1 / outer, curl
