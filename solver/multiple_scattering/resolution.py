"""Choose the degrees of modes that resolve the fields on a sphere, and estimate the error of omitted degrees."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.section import Section
from geometry.scenes.probe import Material
from solver.inclusions.strata import Strata, compute_contrast
from solver.inclusions.tumours import Tumours
from solver.multiple_scattering.spheres import ScatteringSphere

DEGREE_LIMITS = (4, 36)  # minimum and maximum degree of the modes
OMITTED_DEGREES_SHARE = 0.1  # of the effect: error by omitted degrees, times their part of a field next to the surface
MAX_CONTACT_REFLECTIONS = 1000  # reflections considered between a sphere and a surface it almost touches
MIN_GAP_RELATIVE = 1e-9  # diameters: minimum distance from an interface


def compute_degrees(section: Section, tumours: Tumours) -> tuple[Floats, Floats]:
    """Return the degrees that resolve a sphere's image in surface, floor or interface, and the probe's field; (t,) each."""
    radius = tumours.diameter / 2
    image = 5 / np.log1p(2 * _compute_nearest_distance(section, tumours) / radius) + 2
    return np.asarray(image), np.asarray(4 * radius / (section.tube_radius + tumours.cover) + 4)


def _compute_nearest_distance(section: Section, tumours: Tumours) -> Floats:
    """Return the distance from each sphere to the nearest of surface, floor and interfaces, m, shape (t,)."""
    distance = np.minimum(compute_gap(section, tumours), section.tissue_depth - tumours.depth - tumours.diameter / 2)
    return np.asarray(np.maximum(distance, MIN_GAP_RELATIVE * tumours.diameter))


def compute_gap(section: Section, tumours: Tumours) -> Floats:
    """Return the distance from each sphere to the surface or the nearest interface, m, shape (t,)."""
    gaps = [np.abs(tumours.depth - depth) - tumours.diameter / 2 for depth in section.interfaces]
    return np.asarray(np.min([tumours.cover, *gaps], axis=0))


def estimate_unresolved(section: Section, strata: Strata, tumours: Tumours, spheres: Sequence[ScatteringSphere]) -> float:
    """Estimate the relative error of the effect by omitted degrees; for blocks much smaller than the sphere it is unknown.

    The inner block's field at the sphere, of radius R, is as wide as the block plus its distance. The work of degree l also
    decays at least as (R / depth)^2l.
    """
    radius, degree = tumours.diameter / 2, np.array([sphere.modes.degree for sphere in spheres])
    inner, outer = (size + tumours.cover for size in (section.inner_radius, section.tube_radius))
    if np.any(4 * radius / inner + 4 > DEGREE_LIMITS[1]):
        return 1e3
    pressed = np.minimum(np.exp(-degree * inner / (2 * radius)), (radius / tumours.depth) ** (2 * degree))
    images = OMITTED_DEGREES_SHARE * _estimate_images(section, strata, tumours, spheres)
    return float(np.max(images + np.maximum(pressed, np.exp(-degree * outer / (2 * radius)))))


def _estimate_images(section: Section, strata: Strata, tumours: Tumours, spheres: Sequence[ScatteringSphere]) -> Floats:
    """Estimate the fraction of degrees above l in a sphere's images in surface, floor and interfaces, shape (t,).

    For a sphere of radius R at a distance d it is at most (1 + 2 d / R)^(-2 l). If they almost touch, the k-th reflection, a
    fraction q^k of the first field, has (k / (k + 1))^l in the degree l: the larger of both factors squared,

        max_k q^(2 k) (k / (k + 1))^(2 l),    q^2 = unlikeness of sphere and host times that of wall and host          (MS.11)

    where q is the fraction of the field that is left after each reflection. A stiff sphere at the floor needs high degrees; one
    five times as stiff as its layer at an interface does not.
    """
    radius, degree = tumours.diameter / 2, np.array([sphere.modes.degree for sphere in spheres])
    moduli = zip(tumours.youngs_modulus.tolist(), tumours.poisson_ratio.tolist(), strict=True)
    bodies = (Material(youngs_modulus=e, poisson_ratio=nu) for e, nu in moduli)
    sphere_contrasts = np.array([compute_contrast(sphere.matrix, body) for sphere, body in zip(spheres, bodies, strict=True)])
    depths = np.array([0.0, section.tissue_depth, *section.interfaces])
    k = np.arange(1, MAX_CONTACT_REFLECTIONS + 1)[:, None]
    shares = np.zeros(len(radius))
    for depth, contrast in zip(depths, (1.0, 1.0, *strata.contrasts), strict=True):
        gap = np.maximum(np.abs(tumours.depth - depth) - radius, MIN_GAP_RELATIVE * tumours.diameter)
        touching = np.max((sphere_contrasts * contrast) ** k * (k / (k + 1)) ** (2.0 * degree), axis=0)
        shares = np.maximum(shares, np.minimum((1 + 2 * gap / radius) ** (-2.0 * degree), touching))
    return shares
