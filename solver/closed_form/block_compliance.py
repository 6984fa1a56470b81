"""Compliance of a block's tissue end, the other end held by the base: Ritz's method with few functions.

A block is a disc, y = r / radius, or a tube, y = (r - hole) / wall, of height h; zeta runs from its tissue end (0) to the base
(h). Displacements, w towards the tissue and u outwards, are products

    w = sum W_ij P_i f_j(zeta),     u = (1/r) sum a_ij U_i g_j(zeta)                              (CF.8)

with Legendre's polynomials P_i on (0, 1), of y^2 in a disc, of y in a tube, and U_i = Int P_i r dr, in a tube a constant too.
The trace of the strain is d(r u)/dr / r - dw/dzeta; every dU/dr / r g is also a dw/dzeta, as f_0 = 1 - zeta/h,
f_1 = Int_zeta^h (1 - g_0) / h and f_j+1 = -Int_zeta^h g_j / h. So volume can be kept wherever shape changes and nothing locks as
nu nears 1/2. With v = 1 - zeta/h and a decay b of the block's width,

    g_j = (1 - exp(-b h v)) / (1 - exp(-b h)) ((exp(-b zeta) - exp(-b h)) / (1 - exp(-b h)))^j      (CF.9)

which are v, v^2, v^3 in a flat block and, in a tall one, a column clamped at the base with what decays from its loaded end.
The stiffness K of these functions and the work B of tractions on them give the compliance B K^-1 B^T of the end.

Of w, modes are taken that diagonalise the integrals: with k = 2 nu / (1-2nu), derivatives' integrals a_m along the height and b_m
across, D = (k+2) a / h + b h is diagonal. With V the integrals of d(r u)/dr / r and df/dzeta with the modes, T those of u and dg
with their derivatives and themselves, what is left to solve for are the amounts a of the u alone,

    B K^-1 B^T = E S^-1 E^T + C D^-1 C^T,     E = A + C D^-1 (kV + T)^T                           (CF.23)
    S = U + V (k/D) [(2 + b h^2/a) V - T]^T - T D^-1 (kV + T)^T

with U the stiffness of the u without lambda, whose k Int g g h is among the modes: that, less k^2 V V / D, is the sum with k/D
above, which neither nu near 1/2 nor tall blocks rob of digits. A and C are the work of tractions on the u and on the modes.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial, legendre

from solver.closed_form.bessel import Array
from solver.closed_form.block_functions import (
    RADIAL_FUNCTIONS,
    AxialIntegrals,
    RadialIntegrals,
    interpolate_axial_integrals,
    interpolate_radial_integrals,
)
from solver.closed_form.tractions import ElasticBlocks


def _build_polynomials() -> Any:
    """Return the coefficients, by powers of s, of P_i, their derivatives and their integrals over s, shape (3 functions, powers).

    s is (r / radius)^2 of a disc. The integrals are divided by s, so that all have the same number of powers.
    """
    P = [legendre.Legendre(row, domain=[0, 1]) for row in np.eye(RADIAL_FUNCTIONS)]
    kinds = [P, [p.deriv() for p in P], [p.integ(lbnd=0) for p in P]]
    rows = [[p.convert(kind=Polynomial).coef for p in kind] for kind in kinds]
    rows[2] = [row[1:] for row in rows[2]]
    return np.array([np.pad(row, (0, RADIAL_FUNCTIONS - len(row))) for kind in rows for row in kind])


_POLYNOMIAL_COEFFICIENTS = _build_polynomials()


def compute_end_compliance(block: ElasticBlocks, bonded: bool) -> Array:
    """Compute the work of each unit load on the end displacements by each other, m^5/N, shape (n, loads, loads).

    Pressures come before shears; the functions of the shears are multiplied by r / radius. ``bonded`` selects the correction of
    the modulus (eq. CF.10); shears are included in either case.
    """
    wall = None if block.hole is None else block.width / block.radius
    transverse = interpolate_radial_integrals(wall)
    axial = interpolate_axial_integrals(block.steepness)
    slender = block.height / block.width
    pressures, shears = len(transverse.pressed), len(transverse.sheared)
    on_u = np.zeros((pressures + shears, len(transverse.strain), len(axial.gg), len(slender)), dtype=slender.dtype)
    on_u[pressures:] = transverse.sheared[:, :, None]
    on_modes = np.zeros((pressures + shears, len(transverse.derivative), len(axial.end), len(slender)), dtype=slender.dtype)
    on_modes[:pressures] = transverse.pressed[:, :, None] * axial.end
    system = build_ritz_system(block.nu, slender, (transverse, axial), (on_u, on_modes))
    mu = _correct_modulus(block, bonded) / (2 * (1 + block.nu))
    return system.compute_compliance(system.amplitudes) * (block.width * block.width * block.radius / mu)[:, None, None]


def evaluate_radial_functions(radius: Array, r: Array) -> tuple[Array, Array, Array]:
    """Return P_i, dP_i/dr and U_i / r (eq. CF.8) of discs at distances r (n, k) > 0 from the axis, shapes (n, functions, k)."""
    s = (r / radius[:, None]) ** 2
    powers = np.stack([1 + 0 * s, *accumulate([s] * (RADIAL_FUNCTIONS - 1), np.multiply)], axis=1)
    P, derivative, U = np.split(_POLYNOMIAL_COEFFICIENTS @ powers, 3, axis=1)
    return P, derivative * (2 * s / r)[:, None], U * (r / 2)[:, None]


@dataclass(frozen=True)
class RitzSystem:
    """Eq. CF.23 of blocks of width 1, shear modulus 1, all divided by the outer radius.

    Attributes
    ----------
    S
        Stiffness of the functions of u with the modes of w eliminated, shape (n, u, u).
    E
        Work of the loads on these, that through the eliminated modes included, shape (n, loads, u).
    C
        Work of the loads on the modes, shape (n, loads, modes).
    mode_coupling
        D^-1 (kV + T), shape (n, u, modes).
    C_over_D
        C D^-1, shape (n, loads, modes).
    """

    S: Array
    E: Array
    C: Array
    mode_coupling: Array
    C_over_D: Array

    @property
    def amplitudes(self) -> Array:
        """Amounts a of the functions of u (eq. CF.8) under unit loads, shape (n, u, loads)."""
        return np.linalg.solve(self.S, self.E.swapaxes(1, 2))

    def compute_compliance(self, amplitudes: Array) -> Array:
        """Return the compliance B K^-1 B^T from the amounts a, shape (n, loads, loads)."""
        return self.E @ amplitudes + self.C @ self.C_over_D.swapaxes(1, 2)

    def compute_mode_amplitudes(self, amplitudes: Array) -> Array:
        """Return the amounts of the modes under unit loads, from the amounts a of the u, shape (n, modes, loads)."""
        return self.C_over_D.swapaxes(1, 2) + self.mode_coupling.swapaxes(1, 2) @ amplitudes


def build_ritz_system(
    nu: Array, slender: Array, integrals: tuple[RadialIntegrals, AxialIntegrals], loads: tuple[Array, Array]
) -> RitzSystem:
    """Build the reduced Ritz system of eq. CF.23.

    Parameters
    ----------
    nu
        Poisson's ratios, shape (n,).
    slender
        Heights over widths, shape (n,).
    integrals
        Across the blocks and along them.
    loads
        Work of l loads on each u and mode, shapes (l, U_i, g_j, n) and (l, P_i, f_j, n).
    """
    transverse, axial = integrals
    one_minus_2nu, across = 1 - 2 * nu, (transverse.derivative * (slender * slender))[:, None]
    D_inverse = slender / ((2 - 2 * nu) * axial.derivative + one_minus_2nu * across)  # D^-1 of eq. CF.23 over 1 - 2 nu
    V = transverse.widened[:, None, :, None] * axial.g_dmode[None, :, None]
    T = -transverse.turned[:, None, :, None] * axial.dg_mode[None, :, None]
    raised = (2 + across / axial.derivative) * V + T
    raised *= 2 * nu * D_inverse
    coupling = 2 * nu * V - one_minus_2nu * T
    coupling *= D_inverse
    U = transverse.strain[:, None, :, None] * (axial.gg * slender)[None, :, None]
    U += transverse.slide[:, None, :, None] * (axial.dg_dg / slender)[None, :, None]
    on_u, on_modes = (part.reshape(len(part), -1, len(nu)) for part in loads)
    over_D = on_modes * (D_inverse * one_minus_2nu).reshape(-1, len(nu))

    def move_blocks_first(values: Array, rows: int) -> Array:
        """Turn an array whose last axis counts the n blocks into a matrix for each block, shape (n, rows, columns)."""
        return np.ascontiguousarray(values.reshape(rows, -1, len(nu)).transpose(2, 0, 1))

    count = on_u.shape[1]
    V, T, raised, coupling, U = (move_blocks_first(part, count) for part in (V, T, raised, coupling, U))
    A, C, C_over_D = (move_blocks_first(part, len(on_u)) for part in (on_u, on_modes, over_D))
    S = U + V @ raised.swapaxes(1, 2) + T @ coupling.swapaxes(1, 2)
    return RitzSystem(S, A + C @ coupling.swapaxes(1, 2), C, coupling, C_over_D)


# fraction by which the functions are too stiff, with w the width:
# (2 nu)^power / (tall h/w (w/radius)^(3/2) + constant + flat w/h) (CF.10)
_STIFFNESS_EXCESS_FIT = {
    (True, True): (4.05, 3.97, 4.51, 5.92),
    (True, False): (8.24, 8.17, 1.89, 4.89),
    (False, True): (1.65, 8.19, 1.58, 7.06),
    (False, False): (8.72, 4.27, 4.68, 3.50),
}  # (tall, constant, flat, power) for solid or tube; bonded or frictionless


def _correct_modulus(block: ElasticBlocks, bonded: bool) -> Array:
    """Return E reduced by eq. CF.10, because few functions are too stiff: they leave out the singularities of the corners.

    Fitted to finite elements of 300 blocks on stiff ground by ``benchmarks/closed_form/blocks.py``; the remaining error is
    below 1.5 % of a disc, 6 % of a tube.
    """
    tall, constant, flat, power = _STIFFNESS_EXCESS_FIT[block.hole is None, bonded]
    slender, thin = block.height / block.width, block.width / block.radius
    return block.E / (1 + (2 * block.nu) ** power / (tall * slender * thin**1.5 + constant + flat / slender))
