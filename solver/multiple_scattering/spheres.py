"""Represent the spheres of a set with the modes of the fields about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.probe import Material
from solver.inclusions.projection import Projection
from solver.inclusions.sphere_scattering import Scattering, compute_scattering
from solver.inclusions.tumours import Tumours
from solver.inclusions.vector_modes import Modes
from solver.materials.linear import Isotropic
from solver.multiple_scattering.rings import ModeSource


@dataclass(frozen=True)
class ScatteringSphere:
    """A sphere in the axes of the probe, with the modes of the fields about it.

    Attributes
    ----------
    centre
        x, y and z, m, shape (3,).
    radius
        m.
    modes, projection
        Modes, and the projection of displacements on its surface on them.
    matrix
        The material about it.
    layer
        The number of the tissue's layer in which it lies.
    """

    centre: Floats
    radius: float
    modes: Modes
    projection: Projection
    matrix: Material
    layer: int = 0

    @property
    def two_mu(self) -> float:
        """2 mu of the surrounding material, with its shear modulus mu, Pa."""
        return float(Isotropic.from_material(self.matrix).two_mu)

    @property
    def source(self) -> ModeSource:
        """The sphere as a source of outgoing modes."""
        return ModeSource(self.centre, self.radius, self.modes)

    @cached_property
    def points(self) -> Floats:
        """Points at which displacements are projected, m, shape (q, 3)."""
        return np.asarray(self.centre + self.radius * self.projection.points)

    def compute_coefficients(self, displacement: Floats, dilation: Floats | None = None) -> Floats:
        """Compute regular coefficients (modes, k) of a field from displacement (q, 3, k), m, and dilation (q, k) at q points.

        The mode of degree 0, u = c x / R with radius R, is taken from the dilation if that is given: in equilibrium the dilation
        is harmonic, so that its mean over the surface equals that over the ball, 3 c / R. In nearly incompressible tissue an
        error of the displacement's flux would be multiplied by the bulk modulus.
        """
        coefficients = self.projection.coefficients(displacement)
        if dilation is not None:
            mean = self.radius * np.sqrt(4 * np.pi) / 3 * self.projection.weights / (4 * np.pi)
            coefficients[self.modes.ell == 0] = mean @ dilation
        return np.asarray(coefficients)


@dataclass(frozen=True)
class SphereSet:
    """Scattering by all spheres of a set; fields are arrays (modes of all, k), one sphere after the other.

    Attributes
    ----------
    scatterings
        Scattering matrices of the spheres.
    parts
        Slices of their modes.
    """

    scatterings: Sequence[Scattering]
    parts: Sequence[slice]

    @classmethod
    def from_spheres(cls, spheres: Sequence[ScatteringSphere], tumours: Tumours) -> SphereSet:
        """Compute the scattering of t tumours, each in its surrounding material."""
        moduli = zip(spheres, tumours.youngs_modulus, tumours.poisson_ratio, strict=True)
        scatterings = [
            compute_scattering(sphere.modes, sphere.matrix.youngs_modulus, float(E), float(nu), sphere.radius)
            for sphere, E, nu in moduli
        ]
        ends = np.cumsum([0, *(len(sphere.modes) for sphere in spheres)]).tolist()
        return cls(scatterings, [slice(*pair) for pair in pairwise(ends)])

    def scatter(self, c: Floats) -> list[Floats]:
        """Return the outgoing coefficients S c about each sphere, with its scattering matrix S."""
        return [scattering.S @ c[part] for scattering, part in zip(self.scatterings, self.parts, strict=True)]

    def compute_work(self, c: Floats) -> Floats:
        """Return T c, of the shape of c, with the spheres' work matrices T."""
        return np.concatenate([scattering.T @ c[part] for scattering, part in zip(self.scatterings, self.parts, strict=True)])

    def compute_slopes(self, c: Floats) -> Floats:
        """Return c^T (dT / d ln E) c of every sphere, with its work matrix T and modulus E, shape (t, k, k)."""
        pairs = zip(self.scatterings, self.parts, strict=True)
        return np.array([c[part].T @ (scattering.by_log_modulus[1] @ c[part]) for scattering, part in pairs])
