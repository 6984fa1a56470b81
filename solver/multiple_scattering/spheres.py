"""Represent the spheres of a set with the modes of the fields about them: degrees that resolve the fields, and their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.section import Section
from geometry.scenes.probe import Material
from solver.inclusions.projection import Projection
from solver.inclusions.sphere_scattering import Scattering, compute_scattering
from solver.inclusions.tumours import Strata, Tumours, compute_contrast
from solver.inclusions.vector_modes import Modes
from solver.materials.linear import Isotropic

DEGREE_LIMITS = (4, 36)  # minimum and maximum degree of the modes
OMITTED_DEGREES_SHARE = 0.1  # of the effect: error by omitted degrees, times their part of a field next to the surface
MAX_CONTACT_REFLECTIONS = 1000  # reflections considered between a sphere and a surface it almost touches
MIN_GAP_RELATIVE = 1e-9  # diameters: minimum distance from an interface


@dataclass(frozen=True)
class ScatteringSphere:
    """A sphere in the axes of the probe, with the modes of the fields about it.

    Attributes
    ----------
    centre
        Coordinates x, y and z of the centre, m, shape (3,).
    radius
        Radius, m.
    modes, projection
        Modes, and the projection on them of displacements on the sphere's surface.
    matrix
        The material about the sphere.
    layer
        The number of the tissue's layer in which it lies, from the surface downwards.
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
        coefficients = self.projection.compute_coefficients(displacement)
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
        """Return the outgoing coefficients S c about each sphere, from the regular ones c (modes of all, k)."""
        return [scattering.S @ c[part] for scattering, part in zip(self.scatterings, self.parts, strict=True)]

    def compute_work(self, c: Floats) -> Floats:
        """Return T c, of the shape of c, with the spheres' work matrices T."""
        return np.concatenate([scattering.T @ c[part] for scattering, part in zip(self.scatterings, self.parts, strict=True)])

    def compute_slopes(self, c: Floats) -> Floats:
        """Return c^T (dT / d ln E) c of every sphere, with its work matrix T and modulus E, shape (t, k, k)."""
        pairs = zip(self.scatterings, self.parts, strict=True)
        return np.array([c[part].T @ (scattering.by_log_modulus[1] @ c[part]) for scattering, part in pairs])


def compute_degrees(section: Section, strata: Strata, tumours: Tumours) -> tuple[Floats, Floats]:
    """Return the degrees that resolve each sphere's images, and those that resolve the probe's field at it; shape (t,) each.

    Images are the parts of a sphere's field that surface, bottom and interfaces reflect back to it.
    """
    radius = tumours.diameter / 2
    above_floor = section.tissue_depth - tumours.depth - radius
    nearest = np.minimum.reduce([tumours.cover, strata.compute_gap(tumours), above_floor])
    image = 5 / np.log1p(2 * np.maximum(nearest, MIN_GAP_RELATIVE * tumours.diameter) / radius) + 2
    return np.asarray(image), np.asarray(4 * radius / (section.tube_radius + tumours.cover) + 4)


def estimate_unresolved(section: Section, strata: Strata, tumours: Tumours, spheres: Sequence[ScatteringSphere]) -> float:
    """Estimate the relative error of the spheres' effect by omitted degrees; the largest of all spheres.

    For blocks much smaller than the sphere it is unknown, and 1e3 is returned.

    The inner block's field at the sphere, of radius R, is as wide as the block plus its distance. The work of degree l also
    decays at least as (R / depth)^2l.
    """
    radius, degree = tumours.diameter / 2, np.array([sphere.modes.degree for sphere in spheres])
    inner, outer = (size + tumours.cover for size in (section.inner_radius, section.tube_radius))
    if np.any(4 * radius / inner + 4 > DEGREE_LIMITS[1]):
        return 1e3
    pressed = np.minimum(np.exp(-degree * inner / (2 * radius)), (radius / tumours.depth) ** (2 * degree))
    images = OMITTED_DEGREES_SHARE * _estimate_omitted_parts(section, strata, tumours, spheres)
    return float(np.max(images + np.maximum(pressed, np.exp(-degree * outer / (2 * radius)))))


def _estimate_omitted_parts(section: Section, strata: Strata, tumours: Tumours, spheres: Sequence[ScatteringSphere]) -> Floats:
    """Estimate which fraction of the work of each sphere's images is omitted, (t,): that of degrees above its largest degree l.

    Images are the parts of the sphere's field that surface, bottom and interfaces (walls) reflect back to it. For a sphere of
    radius R at a gap d from a wall the fraction is at most (1 + 2 d / R)^(-2 l). If they almost touch, that is close to 1 for any
    l, and another bound is lower. The field is reflected between sphere and wall again and again. After the k-th time a fraction
    q^k of it is left; its source then lies at k / (k + 1) of the radius, so that its part in degree l is (k / (k + 1))^l. Works
    are squares of fields, so that the bound is

        max_k q^(2 k) (k / (k + 1))^(2 l),    q^2 = unlikeness of sphere and host times that of wall and host          (MS.11)

    where unlikeness is the contrast of ``Strata.contrasts``, 1 for surface and bottom. The result is the smaller of
    both bounds, for the worst wall. A stiff sphere at the bottom needs high degrees; one five times as stiff as its
    layer at an interface does not.
    """
    radius, degree = tumours.diameter / 2, np.array([sphere.modes.degree for sphere in spheres])
    moduli = zip(tumours.youngs_modulus.tolist(), tumours.poisson_ratio.tolist(), strict=True)
    bodies = (Material(youngs_modulus=e, poisson_ratio=nu) for e, nu in moduli)
    sphere_contrasts = np.array([compute_contrast(sphere.matrix, body) for sphere, body in zip(spheres, bodies, strict=True)])
    depths = np.array([0.0, section.tissue_depth, *section.interfaces])
    k = np.arange(1, MAX_CONTACT_REFLECTIONS + 1)[:, None]
    fractions = np.zeros(len(radius))
    for depth, contrast in zip(depths, (1.0, 1.0, *strata.contrasts), strict=True):
        gap = np.maximum(np.abs(tumours.depth - depth) - radius, MIN_GAP_RELATIVE * tumours.diameter)
        # MS.11: sphere_contrasts * contrast is q^2, hence the power k and not 2 k
        touching = np.max((sphere_contrasts * contrast) ** k * (k / (k + 1)) ** (2.0 * degree), axis=0)
        separate = (1 + 2 * gap / radius) ** (-2.0 * degree)
        fractions = np.maximum(fractions, np.minimum(separate, touching))
    return fractions
