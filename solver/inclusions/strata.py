"""Find the layers of tissue around spheres: each sphere lies wholly inside one layer, whose material is its matrix."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.scenes.probe import Material
from geometry.scenes.scene import Tissue
from solver.inclusions.tumours import Tumours
from solver.materials.linear import Isotropic


@dataclass(frozen=True)
class Strata:
    """The materials of a tissue from the surface downwards, and where they meet.

    Attributes
    ----------
    interfaces
        Depths of the k interfaces, m, rising.
    materials
        Of the k layers, and the tissue's own below them.
    """

    interfaces: tuple[float, ...]
    materials: tuple[Material, ...]

    @classmethod
    def from_tissue(cls, tissue: Tissue) -> Strata:
        """Build the strata of a scene's tissue."""
        return cls(tissue.interfaces, (*tissue.layer, tissue))

    def find_layer(self, depth: Floats) -> Ints:
        """Return the index of the material at depths, m, of any shape; an interface belongs to the material below it."""
        return np.asarray(np.searchsorted(self.interfaces, depth, side="right"))

    def find_hosts(self, depth: Floats) -> Isotropic:
        """Return the laws at depths, m, of any shape."""
        return Isotropic.from_materials(self.materials).select(self.find_layer(depth))

    def compute_gap(self, tumours: Tumours) -> Floats:
        """Return the distance from each sphere to the nearest interface, m: inf without any, negative where one crosses it."""
        gaps = [np.abs(tumours.depth - depth) - tumours.diameter / 2 for depth in self.interfaces]
        return np.asarray(np.min(gaps, axis=0) if gaps else np.full(tumours.shape, np.inf))

    @cached_property
    def contrasts(self) -> Floats:
        """Contrast of the materials on both sides of each interface: 0 for the same, up to 1, shape (k,).

        The larger of |a - b| / (a + b) for the moduli a, b of both sides: the shear moduli mu, and the moduli of compression
        lambda + 2 mu.
        """
        return np.array([compute_contrast(*pair) for pair in pairwise(self.materials)])


def compute_contrast(upper: Material, lower: Material) -> float:
    """Return the contrast of two materials, see ``Strata.contrasts``."""
    pairs = zip(_compute_moduli(upper), _compute_moduli(lower), strict=True)
    return max(abs(a - b) / (a + b) for a, b in pairs)


def _compute_moduli(material: Material) -> tuple[float, float]:
    """Return the shear modulus and lambda + 2 mu, Pa."""
    law = Isotropic.from_material(material)
    return law.shear_modulus, law.dilation_modulus + law.two_mu
