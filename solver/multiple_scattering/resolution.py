"""Which degrees of modes resolve the fields on a sphere, and what those left out may change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.section import Section
from geometry.scenes.probe import Material
from solver.inclusions.strata import Strata, unlike
from solver.inclusions.tumours import Tumours
from solver.multiple_scattering.spheres import ScatteringSphere

DEGREES = (4, 36)  # least and largest degree of the modes
UNRESOLVED = 0.1  # of the effect: what degrees left out may change, times their share of a field next to the surface
REFLECTED = 1000  # reflections between a sphere and what it all but touches that are looked at
LEAST_GAP = 1e-9  # diameters: what counts as apart from an interface


def degrees(section: Section, tumours: Tumours) -> tuple[Floats, Floats]:
    """Degrees of modes that resolve a sphere's image in surface, floor or interface, and the probe's field, shape (t,) each."""
    radius = tumours.diameter / 2
    image = 5 / np.log1p(2 * _nearest(section, tumours) / radius) + 2
    return np.asarray(image), np.asarray(4 * radius / (section.tube_radius + tumours.cover) + 4)


def _nearest(section: Section, tumours: Tumours) -> Floats:
    """From each sphere to the surface, the floor or an interface."""
    near = np.minimum(apart(section, tumours), section.tissue_depth - tumours.depth - tumours.diameter / 2)
    return np.asarray(np.maximum(near, LEAST_GAP * tumours.diameter))


def apart(section: Section, tumours: Tumours) -> Floats:
    """From each sphere to the surface or an interface, m, shape (t,)."""
    gaps = [np.abs(tumours.depth - depth) - tumours.diameter / 2 for depth in section.interfaces]
    return np.asarray(np.min([tumours.cover, *gaps], axis=0))


def unresolved(section: Section, strata: Strata, tumours: Tumours, spheres: Sequence[ScatteringSphere]) -> float:
    """What too few degrees may change, as a share of the effect: nothing is told of a block much smaller than the sphere.

    What the inner block presses on the sphere is as wide as the block and its distance; nor is it more than falls off as
    (R / depth)^2l, the work of degree l.
    """
    radius, degree = tumours.diameter / 2, np.array([sphere.modes.degree for sphere in spheres])
    inner, outer = (size + tumours.cover for size in (section.inner_radius, section.tube_radius))
    if np.any(4 * radius / inner + 4 > DEGREES[1]):
        return 1e3
    pressed = np.minimum(np.exp(-degree * inner / (2 * radius)), (radius / tumours.depth) ** (2 * degree))
    images = UNRESOLVED * _images(section, strata, tumours, spheres)
    return float(np.max(images + np.maximum(pressed, np.exp(-degree * outer / (2 * radius)))))


def _images(section: Section, strata: Strata, tumours: Tumours, spheres: Sequence[ScatteringSphere]) -> Floats:
    """What degrees above l may have of a sphere's images in surface, floor and interfaces, shape (t,).

    At a distance d it is at most (1 + 2 d / R)^(-2 l). Where the two all but touch, the k-th reflection, a share q^k of the first
    field, has (k / (k + 1))^l in the degree l: the larger of both factors squared,

        max_k q^(2 k) (k / (k + 1))^(2 l),    q^2 = unlikeness of sphere and host times that of wall and host          (MS.11)

    A hard sphere at the floor needs high degrees; one five times as hard as its layer at an interface does not.
    """
    radius, degree = tumours.diameter / 2, np.array([sphere.modes.degree for sphere in spheres])
    moduli = zip(tumours.youngs_modulus.tolist(), tumours.poisson_ratio.tolist(), strict=True)
    bodies = (Material(youngs_modulus=e, poisson_ratio=nu) for e, nu in moduli)
    own = np.array([unlike(sphere.matrix, body) for sphere, body in zip(spheres, bodies, strict=True)])
    depths = np.array([0.0, section.tissue_depth, *section.interfaces])
    k = np.arange(1, REFLECTED + 1)[:, None]
    found = np.zeros(len(radius))
    for depth, contrast in zip(depths, (1.0, 1.0, *strata.contrasts), strict=True):
        gap = np.maximum(np.abs(tumours.depth - depth) - radius, LEAST_GAP * tumours.diameter)
        touching = np.max((own * contrast) ** k * (k / (k + 1)) ** (2.0 * degree), axis=0)
        found = np.maximum(found, np.minimum((1 + 2 * gap / radius) ** (-2.0 * degree), touching))
    return found
