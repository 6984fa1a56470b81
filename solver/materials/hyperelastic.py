r"""Compute stresses and tangents of rubber-like materials at finite strain, with the pressure as a separate unknown.

The stored energy per undeformed volume is

    W = mu f(I - 3) + K/4 (J^2 - 1 - 2 ln J),   I = J^(-2/3) tr(F^T F)                                  (LW.2)

with the deformation gradient F, J = det F, the moduli mu and K of shear and of volume at rest, and a law f of
``strain_energies.py``, by default the neo-Hookean f(x) = x / 2 of ``tests/reference/contact``. The tangent at rest is Hooke's
law.

The fraction lam/K of the part in J, with lam the first Lame constant, is carried by a pressure p, which is a separate unknown:
with U = lam/4 (J^2 - 1 - 2 ln J) and its conjugate U*, U = max over p of p (J - 1) - U*(p), where

    dU*/dp = J*(p) - 1,   J*(p) = p/lam + sqrt(1 + (p/lam)^2)                                            (LW.3)

so that nothing is divided by 1 - 2 nu, and the linear limit is the pair of ``solver/elements/quadrilateral.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.scenes.probe import Material
from solver.materials.linear import Isotropic
from solver.materials.strain_energies import StrainEnergy, build_strain_energy

MIN_LAM_RELATIVE = 1e-3  # of mu: the rest of a more compressible material's bulk modulus needs no pressure unknown
RR, RZ, ZR, ZZ, TT = range(5)  # components of the displacement gradient, first axis: u_r,r, u_r,z, u_z,r, u_z,z, u_r / r


@dataclass(frozen=True)
class Stress:
    """Stress and derivatives for displacement gradients h at q points of n elements, F = 1 + h: shape (n, q), components first.

    The derivative of ``first_piola`` with respect to h is the sum of: the identity times ``identity_coefficient``; d2J/dh2 times
    ``hessian_coefficient``; the outer product of ``distortion`` with itself times ``bend``; and the outer product of ``cofactor``
    with ``cofactor_coefficient``, plus its transpose.

    Attributes
    ----------
    first_piola
        First Piola-Kirchhoff stress without the pressure's part, Pa.
    change
        J - 1.
    cofactor
        dJ/dh.
    F
        Deformation gradient.
    distortion
        dI/dh.
    weight
        Mu f' J^(-2/3), Pa.
    bend
        Mu f'', Pa; None for neo-Hookean materials.
    bulk
        Bulk modulus without the pressure's part, Pa, shape (n, 1).
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
    def shear_stress(self) -> Floats:
        """The part of ``first_piola`` that is proportional to the shear modulus at constant bulk modulus, mu f' dI/dh, Pa."""
        return np.asarray(self.weight * (1 + self.change) ** (2 / 3) * self.distortion)

    @property
    def identity_coefficient(self) -> Floats:
        """Coefficient of the identity in the tangent, Pa."""
        return 2 * self.weight

    @property
    def cofactor_coefficient(self) -> Floats:
        """Factor of dJ/dh in the tangent's outer product (see the class), Pa; half of it, because the transpose is added."""
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

    Attributes
    ----------
    shear
        Shear modulus mu, Pa, shape (n,).
    lam
        Modulus of the pressure's part, Pa, > 0, shape (n,).
    bulk
        Rest of the bulk modulus, K - lam, Pa, shape (n,).
    laws
        Numbers of the elements that are not neo-Hookean, with their f.
    """

    shear: Floats
    lam: Floats
    bulk: Floats
    laws: tuple[tuple[Ints, StrainEnergy], ...] = ()

    @classmethod
    def from_moduli(cls, moduli: Isotropic, laws: tuple[tuple[Ints, StrainEnergy], ...] = ()) -> Hyperelastic:
        """Return the materials of n elements with these moduli at rest, shape (n,); for ``laws`` see the class."""
        lam = np.maximum(moduli.dilation_modulus, MIN_LAM_RELATIVE * moduli.shear_modulus)
        return cls(moduli.shear_modulus, lam, moduli.bulk_modulus - lam, laws)

    @classmethod
    def from_materials(cls, materials: Sequence[Material]) -> Hyperelastic:
        """Return the constants of elements with these materials, one for each."""
        laws = [build_strain_energy(material) for material in materials]
        groups = [(np.flatnonzero([law == other for other in laws]), law) for law in dict.fromkeys(laws) if law is not None]
        return cls.from_moduli(Isotropic.from_materials(materials), tuple(groups))

    def select(self, elements: Ints) -> Hyperelastic:
        """Return the constants of m of the elements, given by their numbers, which may repeat, shape (m,)."""
        laws = tuple((np.flatnonzero(np.isin(elements, numbers)), law) for numbers, law in self.laws)
        return Hyperelastic(self.shear[elements], self.lam[elements], self.bulk[elements], laws)

    def compute_dilation(self, p: Floats) -> tuple[Floats, Floats]:
        """Return J*(p) - 1 of eq. LW.3 and its derivative with respect to p, 1/Pa, at pressures p, Pa; shape (n, q) each."""
        x = p / self.lam[:, None]
        root = np.sqrt(1 + x**2)
        # x + root - 1, without cancellation
        return x + x**2 / (1 + root), (1 + x / root) / self.lam[:, None]

    def compute_energy_density(self, h: Floats, p: Floats) -> Floats:
        """Return the energy per undeformed volume, Pa, (n, q), for displacement gradients (5, n, q) and pressures p, Pa, (n, q).

        The pressure's part is p (J - J*(p)) + U(J*(p)), which in equilibrium equals that of eq. LW.2.
        """
        change, dilation = compute_volume_change(h), self.compute_dilation(p)[0]
        bulk, lam = (modulus[:, None] / 4 * _compute_volume_term(x) for modulus, x in ((self.bulk, change), (self.lam, dilation)))
        return np.asarray(self._evaluate_laws(compute_distortion(h))[0] + bulk + lam + p * (change - dilation))

    def _evaluate_laws(self, x: Floats) -> tuple[Floats, Floats, Floats | None]:
        """Return mu f, mu f' and mu f'' at x = I - 3, shape (n, q) each; None for f'' if all is neo-Hookean."""
        mu = self.shear[:, None]
        energy, derivative = mu / 2 * x, np.repeat(mu / 2, x.shape[1], axis=1)
        if not self.laws:
            return energy, derivative, None
        bend = np.zeros_like(x)
        for elements, law in self.laws:
            for whole, part in zip((energy, derivative, bend), law.evaluate(x[elements]), strict=True):
                whole[elements] = mu[elements] * part
        return energy, derivative, bend

    def find_max_distortions(self, h: Floats) -> list[float]:
        """Return the largest I - 3 in the elements of each of ``laws``, for displacement gradients h, shape (5, n, q)."""
        return [float(compute_distortion(h[:, elements]).max()) for elements, _ in self.laws]

    def compute_stress(self, h: Floats) -> Stress:
        """Return the stresses, without the pressure's part, and their derivatives for displacement gradients h, (5, n, q)."""
        F = h.copy()
        F[[RR, ZZ, TT]] += 1.0
        cof, change, trace = compute_cofactor(F), compute_volume_change(h), _compute_trace(h)
        J = 1 + change
        power = J ** (-2 / 3)
        # dI/dF of I = J^(-2/3) I1 from small terms only: the rounding of 1 would appear as stress in large elements
        excess = (2 * trace / 3 - change) / J
        distortion = 2 * power * (h - _compute_cofactor_change(h) - excess * cof)
        _, derivative, bend = self._evaluate_laws((3 + 2 * trace) * power - 3)
        bulk = self.bulk[:, None]
        P = derivative * distortion + bulk / 2 * change * (1 + 1 / J) * cof
        return Stress(P, change, cof, F, distortion, derivative * power, bend, bulk)


def compute_cofactor(F: Floats) -> Floats:
    """Return the cofactor dJ/dF of deformation gradients F with components RR, RZ, ZR, ZZ and TT; shape (5, ...) both."""
    rr, rz, zr, zz, tt = F
    return np.stack([zz * tt, -zr * tt, -rz * tt, rr * tt, rr * zz - rz * zr])


def compute_volume_change(h: Floats) -> Floats:
    """Return J - 1 for displacement gradients h, shape (5, ...), without the rounding error of J."""
    rr, rz, zr, zz, tt = h
    flat = rr + zz + rr * zz - rz * zr  # change of area in the meridian plane
    return np.asarray(flat + tt + flat * tt)


def _compute_cofactor_change(h: Floats) -> Floats:
    """Return dJ/dF minus its value at rest (the unit matrix) for displacement gradients h, (5, ...), without rounding error."""
    rr, rz, zr, zz, tt = h
    return np.stack([zz + tt + zz * tt, -zr * (1 + tt), -rz * (1 + tt), rr + tt + rr * tt, rr + zz + rr * zz - rz * zr])


def compute_distortion(h: Floats) -> Floats:
    """Return I - 3 of eq. LW.2 for displacement gradients h."""
    return np.asarray((3 + 2 * _compute_trace(h)) * (1 + compute_volume_change(h)) ** (-2 / 3) - 3)


def _compute_volume_term(change: Floats) -> Floats:
    """Return J^2 - 1 - 2 ln J, the volume term of eq. LW.2, for change = J - 1."""
    return np.asarray(change * (2 + change) - 2 * np.log1p(change))


def _compute_trace(h: Floats) -> Floats:
    """Return (tr F^T F - 3) / 2 for displacement gradients h, without rounding error."""
    return np.asarray(h[RR] + h[ZZ] + h[TT] + (h**2).sum(axis=0) / 2)
