"""Compute linear elastic laws: stiffness matrices between stresses and small strains.

Strains and stresses are vectors in the order of ``VOIGT_PAIRS``, with engineering shear strains 2 eps_ij. The stiffness of an
isotropic material of Young's modulus E and Poisson's ratio nu is

    C = lambda 1 x 1 + 2 mu I,   2 mu = E / (1 + nu),   lambda = 2 mu nu / (1 - 2 nu),   K = E / (3 (1 - 2 nu))             (LW.1)
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from geometry.common.arrays import Floats, Ints, Numeric

VOIGT_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))  # xx, yy, zz, yz, xz, xy
VOIGT_INDEX = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])  # of each component among these
VOIGT_WEIGHTS = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])  # of the products s_ij e_ij in s:e


class Elastic(Protocol):
    """A scene's material or its law, with Young's modulus, Pa, and Poisson's ratio."""

    @property
    def youngs_modulus(self) -> float: ...  # noqa: D102
    @property
    def poisson_ratio(self) -> float: ...  # noqa: D102


class LinearLaw(Protocol):
    """A linear elastic material of any symmetry."""

    @property
    def dilation_modulus(self) -> float:
        """The factor of 1 x 1 in the stiffness that elements apply to projected dilations, so that they do not lock, Pa."""

    def build_stiffness(self) -> Floats:
        """Return the stiffness between strains with engineering shears and stresses, Pa, shape (6, 6)."""


@dataclass(frozen=True)
class Isotropic:
    """Isotropic materials; numbers or arrays of one shape, complex for derivatives by complex steps.

    Attributes
    ----------
    youngs_modulus
        E of eq. LW.1, Pa.
    poisson_ratio
        Poisson's ratio nu, below 1/2.
    """

    youngs_modulus: Numeric
    poisson_ratio: Numeric

    @classmethod
    def from_material(cls, material: Elastic) -> Isotropic:
        """Return the law of a scene's material at small strain."""
        return cls(material.youngs_modulus, material.poisson_ratio)

    @classmethod
    def from_materials(cls, materials: Iterable[Elastic]) -> Isotropic:
        """Return the laws of several materials as arrays, shape (n,)."""
        return cls(*np.array([(material.youngs_modulus, material.poisson_ratio) for material in materials], dtype=float).T)

    def select(self, chosen: Ints | slice) -> Isotropic:
        """Return the materials ``chosen``, by their numbers, if these are arrays."""
        return Isotropic(self.youngs_modulus[chosen], self.poisson_ratio[chosen])

    @property
    def two_mu(self) -> Numeric:
        """Twice the shear modulus, Pa."""
        return self.youngs_modulus / (1 + self.poisson_ratio)

    @property
    def shear_modulus(self) -> Numeric:
        """The shear modulus mu, Pa."""
        return self.youngs_modulus / (2 * (1 + self.poisson_ratio))

    @property
    def bulk_modulus(self) -> Numeric:
        """The bulk modulus K, Pa."""
        return self.youngs_modulus / (3 * (1 - 2 * self.poisson_ratio))

    @property
    def dilation_modulus(self) -> Numeric:
        """Lame's lambda, Pa."""
        return self.two_mu * self.poisson_ratio / (1 - 2 * self.poisson_ratio)

    @property
    def dilation_modulus_by_poisson(self) -> Numeric:
        """The derivative of lambda with respect to nu at fixed E, Pa."""
        nu = self.poisson_ratio
        return self.two_mu * (1 + 2 * nu**2) / ((1 + nu) * (1 - 2 * nu) ** 2)

    def build_stiffness(self) -> Floats:
        """Return the stiffness of one material, see ``LinearLaw``."""
        mu = self.shear_modulus
        C = np.diag([2 * mu] * 3 + [mu] * 3)
        C[:3, :3] += self.dilation_modulus
        return np.asarray(C, dtype=float)
