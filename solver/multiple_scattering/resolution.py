"""Which degrees of modes resolve the fields on a sphere, and what those left out may change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.section import Section
from solver.inclusions.tumours import Tumours
from solver.multiple_scattering.spheres import ScatteringSphere

DEGREES = (4, 36)  # least and largest degree of the modes
UNRESOLVED = 0.1  # of the effect: what degrees left out may change, times their share of a field next to the surface
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


def unresolved(section: Section, tumours: Tumours, spheres: Sequence[ScatteringSphere]) -> float:
    """What too few degrees may change, as a share of the effect: nothing is told of a block much smaller than the sphere.

    What the inner block presses on the sphere is as wide as the block and its distance; nor is it more than falls off as
    (R / depth)^2l, the work of degree l.
    """
    radius, degree = tumours.diameter / 2, np.array([sphere.modes.degree for sphere in spheres])
    inner, outer = (size + tumours.cover for size in (section.inner_radius, section.tube_radius))
    if np.any(4 * radius / inner + 4 > DEGREES[1]):
        return 1e3
    image = UNRESOLVED * (1 + 2 * _nearest(section, tumours) / radius) ** (-2.0 * degree)
    pressed = np.minimum(np.exp(-degree * inner / (2 * radius)), (radius / tumours.depth) ** (2 * degree))
    return float(np.max(image + np.maximum(pressed, np.exp(-degree * outer / (2 * radius)))))
