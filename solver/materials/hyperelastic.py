r"""Compute stresses and tangents of rubber-like materials at finite strain, with the pressure as a separate unknown.

The stored energy per undeformed volume is

    W = f(I - 3) + K/4 (J^2 - 1 - 2 ln J),   I = J^(-2/3) tr(F^T F),   f(x) = c1 x + c2 x^2 + c3 x^3       (LW.2)

with the deformation gradient F, J = det F, the bulk modulus K and material constants c1, c2, c3. c1 = mu/2, c2 = c3 = 0 is the
neo-Hookean law of ``tests/reference/contact``; others are
Yeoh's (Rubber Chem. Technol. 66, 1993, 754). Its tangent at rest is Hooke's law with the shear modulus mu = 2 c1.

The share lam/K of the part in J, lam the first Lame constant, is carried by a pressure p that is an unknown of its own: with
U = lam/4 (J^2 - 1 - 2 ln J) and its conjugate U*, U = max over p of p (J - 1) - U*(p), where

    dU*/dp = J*(p) - 1,   J*(p) = p/lam + sqrt(1 + (p/lam)^2)                                            (LW.3)

so that nothing is divided by 1 - 2 nu, and the linear limit is the pair of ``solver/elements/quadrilateral.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats

MIN_LAM_RELATIVE = 1e-3  # of mu: the rest of a more compressible material's bulk modulus needs no pressure unknown
RR, RZ, ZR, ZZ, TT = range(5)  # components of the displacement gradient, first axis: u_r,r, u_r,z, u_z,r, u_z,z, u_r / r


@dataclass(frozen=True)
class Stress:
    """Stress and derivatives for displacement gradients h at q points of n elements, F = 1 + h: shape (n, q), components first.

    The derivative of ``first_piola`` with respect to h is the sum of: the identity times ``identity_coefficient``; d2J/dh2 times
    ``hessian_coefficient``; the outer product of ``distortion`` with itself times ``bend``; and the outer product of ``cofactor``
    with ``cofactor_coefficient``, plus its transpose.

    Attributes:
        first_piola: first Piola-Kirchhoff stress without the pressure's share, Pa.
        change: J - 1.
        cofactor: dJ/dh.
        F: deformation gradient.
        distortion: dI/dh.
        weight: f' J^(-2/3), Pa.
        bend: f'', Pa; None for neo-Hookean materials.
        bulk: bulk modulus without the pressure's share, Pa, shape (n, 1).
    """

    first_piola: Floats
    change: Floats
    cofactor: Floats
    F: Floats
    distortion: Floats
    weight: Floats
    bend: Floats | None
    bulk: Floats

    @property
    def identity_coefficient(self) -> Floats:
        """Coefficient of the identity in the tangent, Pa."""
        return 2 * self.weight

    @property
    def cofactor_coefficient(self) -> Floats:
        """Partner of dJ/dF in the tangent, Pa; half of the product, because its transpose is added."""
        J = 1 + self.change
        coefficient = 5 * self.weight * (self.F**2).sum(axis=0) / (9 * J**2) + self.bulk / 4 * (1 + 1 / J**2)
        return np.asarray(coefficient * self.cofactor - (4 * self.weight / (3 * J)) * self.F)

    @property
    def hessian_coefficient(self) -> Floats:
        """Coefficient of d2J/dh2 in the tangent, Pa."""
        J = 1 + self.change
        pull = self.bulk / 2 * self.change * (1 + 1 / J)
        return np.asarray(pull - 2 * self.weight * (self.F**2).sum(axis=0) / (3 * J))


@dataclass(frozen=True)
class Hyperelastic:
    """Material constants of n elements, for the law of eq. LW.2.

    Attributes:
        shear: mu = 2 c1, Pa, shape (n,).
        lam: modulus of the pressure's share, Pa, > 0, shape (n,).
        bulk: rest of the bulk modulus, K - lam, Pa, shape (n,).
        yeoh: c2 / mu and c3 / mu, shape (2, n); zeros for neo-Hookean materials.
    """

    shear: Floats
    lam: Floats
    bulk: Floats
    yeoh: Floats

    @classmethod
    def from_moduli(cls, youngs_modulus: Floats, poisson_ratio: Floats, yeoh: Floats | None = None) -> Hyperelastic:
        """Return the materials with these Young's moduli (Pa) and Poisson's ratios at rest, shape (n,) each."""
        shear = youngs_modulus / (2 * (1 + poisson_ratio))
        bulk = youngs_modulus / (3 * (1 - 2 * poisson_ratio))
        lam = np.maximum(bulk - 2 * shear / 3, MIN_LAM_RELATIVE * shear)
        return cls(shear, lam, bulk - lam, np.zeros((2, len(shear))) if yeoh is None else yeoh)

    def compute_dilation(self, p: Floats) -> tuple[Floats, Floats]:
        """Return J*(p) - 1 of eq. LW.3 and its derivative with respect to p, 1/Pa, at pressures p, Pa; shape (n, q) each."""
        x = p / self.lam[:, None]
        root = np.sqrt(1 + x**2)
        return x + x**2 / (1 + root), (1 + x / root) / self.lam[:, None]

    def compute_energy_density(self, h: Floats, p: Floats) -> Floats:
        """Return the energy per undeformed volume, Pa, (n, q), for displacement gradients (5, n, q) and pressures p, Pa, (n, q).

        The pressure's share is p (J - J*(p)) + U(J*(p)), which in equilibrium equals its part of eq. LW.2.
        """
        change, dilation = compute_volume_change(h), self.compute_dilation(p)[0]
        distortion = (3 + 2 * _compute_trace(h)) * (1 + change) ** (-2 / 3) - 3
        bulk, lam = (modulus[:, None] / 4 * _compute_volume_term(x) for modulus, x in ((self.bulk, change), (self.lam, dilation)))
        return np.asarray(self._evaluate_f(distortion)[0] + bulk + lam + p * (change - dilation))

    def _evaluate_f(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Return f, f' and f'' of eq. LW.2 at x = I - 3, shape (n, q) each."""
        mu, (c2, c3) = self.shear[:, None], self.shear[:, None] * self.yeoh[:, :, None]
        return mu / 2 * x + c2 * x**2 + c3 * x**3, mu / 2 + 2 * c2 * x + 3 * c3 * x**2, 2 * c2 + 6 * c3 * x

    def compute_stress(self, h: Floats) -> Stress:
        """Return stresses and their derivatives for displacement gradients h, shape (5, n, q)."""
        F = h.copy()
        F[[RR, ZZ, TT]] += 1.0
        cof, change, trace = compute_cofactor(F), compute_volume_change(h), _compute_trace(h)
        J = 1 + change
        power = J ** (-2 / 3)
        # dI/dF of I = J^(-2/3) I1 from small terms only: the rounding of 1 would appear as stress in large elements
        excess = (2 * trace / 3 - change) / J
        distortion = 2 * power * (h - _compute_cofactor_change(h) - excess * cof)
        _, slope, bend = self._evaluate_f((3 + 2 * trace) * power - 3)
        bulk = self.bulk[:, None]
        P = slope * distortion + bulk / 2 * change * (1 + 1 / J) * cof
        return Stress(P, change, cof, F, distortion, slope * power, bend if np.any(self.yeoh) else None, bulk)


def compute_cofactor(F: Floats) -> Floats:
    """Return dJ/dF for deformation gradients F, shape (5, ...) both."""
    rr, rz, zr, zz, tt = F
    return np.stack([zz * tt, -zr * tt, -rz * tt, rr * tt, rr * zz - rz * zr])


def compute_volume_change(h: Floats) -> Floats:
    """Return J - 1 for displacement gradients h, shape (5, ...), without the rounding error of J."""
    rr, rz, zr, zz, tt = h
    flat = rr + zz + rr * zz - rz * zr
    return np.asarray(flat + tt + flat * tt)


def _compute_cofactor_change(h: Floats) -> Floats:
    """Return dJ/dF minus its value at rest, without rounding error."""
    rr, rz, zr, zz, tt = h
    return np.stack([zz + tt + zz * tt, -zr * (1 + tt), -rz * (1 + tt), rr + tt + rr * tt, rr + zz + rr * zz - rz * zr])


def _compute_volume_term(change: Floats) -> Floats:
    """Return J^2 - 1 - 2 ln J, the volume term of eq. LW.2, for change = J - 1."""
    return np.asarray(change * (2 + change) - 2 * np.log1p(change))


def _compute_trace(h: Floats) -> Floats:
    """Return (tr F^T F - 3) / 2 for displacement gradients h, without rounding error."""
    return np.asarray(h[RR] + h[ZZ] + h[TT] + (h**2).sum(axis=0) / 2)
