r"""Rubber-like materials at finite strain: stresses and tangents from the displacement gradient, pressure told apart.

The stored energy per undeformed volume is

    W = f(I - 3) + K/4 (J^2 - 1 - 2 ln J),   I = J^(-2/3) tr(F^T F),   f(x) = c1 x + c2 x^2 + c3 x^3       (CT.1)

with J = det F and the bulk modulus K. c1 = mu/2, c2 = c3 = 0 is the neo-Hookean law of ``tests/reference/contact``; others are
Yeoh's (Rubber Chem. Technol. 66, 1993, 754). Its tangent at rest is Hooke's law with the shear modulus mu = 2 c1.

Of the part in J the share lam/K, lam the first Lame constant, is told by a pressure p that is an unknown of its own: with
U = lam/4 (J^2 - 1 - 2 ln J) and its conjugate U*, U = max over p of p (J - 1) - U*(p), where

    dU*/dp = J*(p) - 1,   J*(p) = p/lam + sqrt(1 + (p/lam)^2)                                            (CT.2)

so that nothing is divided by 1 - 2 nu, and the linear limit is the pair of ``solver/axisymmetric/quadrilateral.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats

LEAST_LAM = 1e-3  # of mu: a material that is more compressible tells the rest of its bulk modulus without a pressure
RR, RZ, ZR, ZZ, TT = range(5)  # components of the displacement gradient: u_r,r, u_r,z, u_z,r, u_z,z, u_r / r
# second derivatives of J = (F_rr F_zz - F_rz F_zr) F_tt: pairs of components, the third that remains, the sign
_CROSSED = ((RR, ZZ, TT, 1.0), (RR, TT, ZZ, 1.0), (ZZ, TT, RR, 1.0), (RZ, ZR, TT, -1.0), (RZ, TT, ZR, -1.0), (ZR, TT, RZ, -1.0))


@dataclass(frozen=True)
class Hyperelastic:
    """Eq. CT.1 for n elements.

    Attributes:
        shear: mu = 2 c1, Pa, shape (n,).
        lam: of the pressure's share, Pa, > 0, shape (n,).
        bulk: what is left of the bulk modulus, K - lam, Pa, shape (n,).
        yeoh: c2 / mu and c3 / mu, shape (2, n); zeros for neo-Hookean materials.
    """

    shear: Floats
    lam: Floats
    bulk: Floats
    yeoh: Floats

    @classmethod
    def of(cls, youngs_modulus: Floats, poisson_ratio: Floats, yeoh: Floats | None = None) -> Hyperelastic:
        """Return the materials with these constants at rest, Pa, shape (n,) each."""
        shear = youngs_modulus / (2 * (1 + poisson_ratio))
        bulk = youngs_modulus / (3 * (1 - 2 * poisson_ratio))
        lam = np.maximum(bulk - 2 * shear / 3, LEAST_LAM * shear)
        return cls(shear, lam, bulk - lam, np.zeros((2, len(shear))) if yeoh is None else yeoh)

    def dilation(self, p: Floats) -> tuple[Floats, Floats]:
        """Return J*(p) - 1 of eq. CT.2 and its derivative by p, 1/Pa, at pressures p, Pa, shape (n, q) each."""
        x = p / self.lam[:, None]
        root = np.sqrt(1 + x**2)
        return x + x**2 / (1 + root), (1 + x / root) / self.lam[:, None]

    def stored(self, h: Floats, p: Floats) -> Floats:
        """Energy per undeformed volume, Pa, (n, q), at displacement gradients (n, q, 5) and pressures p, Pa, (n, q).

        The pressure's share is p (J - J*(p)) + U(J*(p)), which in equilibrium is what eq. CT.1 stores.
        """
        change, held = change_of_volume(h), self.dilation(p)[0]
        distortion = (3 + 2 * _trace(h)) * (1 + change) ** (-2 / 3) - 3
        bulk, lam = (modulus[:, None] / 4 * _volume(x) for modulus, x in ((self.bulk, change), (self.lam, held)))
        return np.asarray(self._f(distortion)[0] + bulk + lam + p * (change - held))

    def _f(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """f, f' and f'' at x = I - 3, shape (n, q)."""
        mu, (c2, c3) = self.shear[:, None], self.shear[:, None] * self.yeoh[:, :, None]
        return mu / 2 * x + c2 * x**2 + c3 * x**3, mu / 2 + 2 * c2 * x + 3 * c3 * x**2, 2 * c2 + 6 * c3 * x

    def stress(self, h: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Return what follows from displacement gradients h, shape (n, q, 5).

        Returns:
            The first Piola-Kirchhoff stress without the pressure's share, Pa, (n, q, 5), its derivative by h, (n, q, 5, 5),
            J - 1, (n, q), dJ/dh, (n, q, 5), and d2J/dh2, (n, q, 5, 5).
        """
        F = h + np.array([1.0, 0.0, 0.0, 1.0, 1.0])
        cof, second = cofactor(F), cofactor_slope(F)
        change = change_of_volume(h)
        J = 1 + change
        power, I1 = J ** (-2 / 3), (F**2).sum(axis=-1)
        # dI/dF and d2I/dF2 with I = J^(-2/3) I1; the first by what is small, or rounding of 1 would be stresses in large elements
        excess = ((2 * _trace(h) / 3 - change) / J)[..., None]
        first = 2 * power[..., None] * (h - _cofactor_change(h) - excess * cof)
        _, slope, bend = self._f(power * I1 - 3)
        pull, stiff = (self.bulk[:, None] / 2 * x for x in (change * (1 + 1 / J), 1 + 1 / J**2))
        P = slope[..., None] * first + pull[..., None] * cof
        weight = slope * power
        # of products of dJ/dF with itself and with F, half: they are added to their transposes
        half = (5 * weight * I1 / (9 * J**2) + stiff / 2)[..., None] * cof - (4 * weight / (3 * J))[..., None] * F
        A = cof[..., :, None] * half[..., None, :]
        A = A + np.swapaxes(A, -1, -2)
        A += (pull - 2 * weight * I1 / (3 * J))[..., None, None] * second
        A[..., range(5), range(5)] += 2 * weight[..., None]
        if np.any(self.yeoh):
            A += bend[..., None, None] * (first[..., :, None] * first[..., None, :])
        return P, A, change, cof, second


def cofactor(F: Floats) -> Floats:
    """dJ/dF of deformation gradients F, shape (..., 5) both."""
    rr, rz, zr, zz, tt = np.moveaxis(F, -1, 0)
    return np.stack([zz * tt, -zr * tt, -rz * tt, rr * tt, rr * zz - rz * zr], axis=-1)


def cofactor_slope(F: Floats) -> Floats:
    """d2J/dF2, shape (..., 5, 5)."""
    out = np.zeros((*F.shape, 5))
    for i, j, other, sign in _CROSSED:
        out[..., i, j] = out[..., j, i] = sign * F[..., other]
    return out


def change_of_volume(h: Floats) -> Floats:
    """J - 1 without the rounding of J, from displacement gradients h, shape (..., 5)."""
    rr, rz, zr, zz, tt = np.moveaxis(h, -1, 0)
    flat = rr + zz + rr * zz - rz * zr
    return np.asarray(flat + tt + flat * tt)


def _cofactor_change(h: Floats) -> Floats:
    """dJ/dF less what it is at rest, without its rounding."""
    rr, rz, zr, zz, tt = np.moveaxis(h, -1, 0)
    return np.stack([zz + tt + zz * tt, -zr * (1 + tt), -rz * (1 + tt), rr + tt + rr * tt, rr + zz + rr * zz - rz * zr], axis=-1)


def _volume(change: Floats) -> Floats:
    """J^2 - 1 - 2 ln J at J - 1."""
    return np.asarray(change * (2 + change) - 2 * np.log1p(change))


def _trace(h: Floats) -> Floats:
    """(tr F^T F - 3) / 2 without its rounding."""
    return np.asarray(h[..., RR] + h[..., ZZ] + h[..., TT] + (h**2).sum(axis=-1) / 2)
