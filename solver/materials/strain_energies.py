"""Compute strain energies of rubber-like materials as functions f of x = I - 3, in shear moduli; see ``hyperelastic.py``.

A law is stable as long as the stress of a stretched incompressible body rises. With the stretch s and the invariant I(s) in one
mode of deformation, the nominal stress f' I' rises while

    f' > 0,   f' I'' + f'' I'^2 > 0                                                              (LW.4)

in uniaxial, equibiaxial and planar tension (D. C. Drucker's condition in these modes).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.probe import Material

MAX_TESTED_STRETCH, TESTED_STRETCHES = 10.0, 2000  # of eq. LW.4, from 1 and from its inverse


class StrainEnergy(Protocol):
    """The law of one material at finite strain."""

    @property
    def description(self) -> str:
        """The law with its constants, for messages."""

    def evaluate(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Return f, f' and f'' at x, in shear moduli; f'(0) = 1/2. All arrays have one shape."""


@dataclass(frozen=True)
class Yeoh:
    """f = (x + c2 x^2 + c3 x^3) / 2 (O. H. Yeoh, Rubber Chem. Technol. 66, 1993, 754).

    Attributes
    ----------
    c2, c3
        The constants C2 and C3 over C1 = mu / 2.
    """

    c2: float
    c3: float

    @property
    def description(self) -> str:
        """The law with its constants, for messages."""
        return f"Yeoh's law with c2_over_c1 = {self.c2:g}, c3_over_c1 = {self.c3:g}"

    def evaluate(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Return f, f' and f'' at x = I - 3, in shear moduli, shape as x; see ``StrainEnergy``."""
        c2, c3 = self.c2, self.c3
        return (x + c2 * x**2 + c3 * x**3) / 2, (1 + 2 * c2 * x + 3 * c3 * x**2) / 2, c2 + 3 * c3 * x


def build_strain_energy(material: Material) -> StrainEnergy | None:
    """Return the strain energy f(x) of a material with x = I - 3; None for neo-Hookean materials, whose f is x / 2."""
    if material.law == "yeoh" and (material.c2_over_c1 or material.c3_over_c1):
        return Yeoh(material.c2_over_c1, material.c3_over_c1)
    return None


@dataclass(frozen=True)
class StableRange:
    """The range in which a law is stable, eq. LW.4.

    Attributes
    ----------
    x
        The largest I - 3; infinite if nothing was found up to ``MAX_TESTED_STRETCH``.
    stretch
        Stretch of a body in uniaxial tension at that limit.
    """

    x: float
    stretch: float

    @classmethod
    def from_law(cls, law: StrainEnergy) -> StableRange:
        """Find the range in which a law is stable, by testing eq. LW.4 at many stretches in all three modes."""
        s = np.geomspace(1.0, MAX_TESTED_STRETCH, TESTED_STRETCHES)
        limit = np.inf
        for stretches in (s, 1 / s):
            for invariant, first, second in list_modes(stretches):
                _, derivative, bend = law.evaluate(invariant - 3)
                unstable = (derivative <= 0) | (derivative * second + bend * first**2 <= 0)
                limit = min(limit, float(np.min(invariant[unstable] - 3, initial=np.inf)))
        pulled = s**2 + 2 / s - 3  # I - 3 in uniaxial tension
        return cls(limit, float(np.interp(limit, pulled, s)))


def list_modes(s: Floats) -> tuple[tuple[Floats, Floats, Floats], ...]:
    """Return I and its first two derivatives with respect to the stretch s, in uniaxial, equibiaxial and planar tension."""
    return (
        (s**2 + 2 / s, 2 * s - 2 / s**2, 2 + 4 / s**3),
        (2 * s**2 + s**-4, 4 * s - 4 * s**-5, 4 + 20 * s**-6),
        (s**2 + s**-2 + 1, 2 * s - 2 * s**-3, 2 + 6 * s**-4),
    )
