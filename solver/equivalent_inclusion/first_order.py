"""Compute first-order changes of the film forces by tumours: integrals of the undisturbed strains over their volume.

By reciprocity a sphere changes the film forces F_ij of the base states by

    dF_ij = Int [k_v tr(eps_i) tr(eps_j) + k_d e_i:e_j] dV                                        (EI.1)

with the strains eps_i of the tissue without the sphere, their deviators e_i, and the sphere's strengths k_v and k_d, eq. IN.2 of
``solver/inclusions/eshelby.py`` (PHYSICS section 4). Effects of several spheres add. The derivatives of eq. EI.1 with respect to
the position of the sphere's centre and to its radius are integrals of the same products over its surface
(EI.2).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.special import roots_jacobi

from geometry.common.arrays import Floats
from geometry.scenes.probe import Material
from solver.equivalent_inclusion.strain_products import Energies
from solver.inclusions.eshelby import compute_strength
from solver.inclusions.tumours import Tumours
from solver.materials.linear import Isotropic

TUMOURS_PER_CHUNK = 1000  # tumours at a time, to limit memory
MAX_TUMOURS_WITHOUT_TABLE = 20  # up to so many tumours a table of strain products does not pay
BALL_POINTS = (3, 5, 5)  # along radius, height and half the azimuth: exact for polynomials of degree 5 and more
SURFACE_POINTS = (8, 8)  # along height and half the azimuth
PAIR_INDEX = np.array([[0, 1], [1, 2]])  # of a pair of states among the three products


@dataclass(frozen=True)
class Effects:
    """Changes of the film forces F_ij (N/m) by n spheres, each alone.

    Attributes
    ----------
    forces
        Eq. EI.1, shape (n, 2, 2).
    derivatives
        Of ``forces`` with respect to quantities of the sphere, of the same shape: the logarithm of its youngs_modulus, and where
        requested of its diameter and its depth, its poisson_ratio, and its offset from the probe's axis, per m.
    """

    forces: Floats
    derivatives: dict[str, Floats]


def compute_effects(energies: Energies, hosts: Material | Isotropic, tumours: Tumours, places: bool = False) -> Effects:
    """Compute the first-order effect of each of n spheres (arrays of shape (n,)).

    Parameters
    ----------
    energies
        Of the base states.
    hosts
        The material about them, one for all or each its own.
    tumours
        The spheres.
    places
        Whether to compute all derivatives and not only that with respect to Young's modulus.

    Raises
    ------
    InputError
        A sphere lies partly outside the tissue.
    """
    strength = compute_strength(hosts, tumours.youngs_modulus, tumours.poisson_ratio)
    radius = tumours.diameter / 2
    (mean,) = _integrate_products(energies, tumours, *build_half_ball(*BALL_POINTS))
    inside = mean * (4 / 3 * np.pi * radius**3)[:, None]
    forces = _combine_products(inside, strength.volume, strength.shear)
    derivatives = {"youngs_modulus": _combine_products(inside, *strength.by_log_modulus)}
    if places:
        surface_mean, upward_moment, outward_moment = (
            _combine_products(part * (4 * np.pi * radius**2)[:, None], strength.volume, strength.shear)
            for part in _integrate_products(energies, tumours, *_build_half_sphere(*SURFACE_POINTS))
        )
        derivatives |= {
            "poisson_ratio": _combine_products(inside, *strength.by_poisson),
            "depth": -upward_moment * tumours.depth[:, None, None],
            "offset": outward_moment,
            "diameter": surface_mean * radius[:, None, None],
        }
    return Effects(forces, derivatives)


def _combine_products(products: Floats, volume: Floats, shear: Floats) -> Floats:
    """Return k_v times the first three plus k_d times the last three of six products (n, 6) as symmetric matrices (n, 2, 2)."""
    return np.asarray((volume[:, None] * products[:, :3] + shear[:, None] * products[:, 3:])[:, PAIR_INDEX])


def _integrate_products(energies: Energies, tumours: Tumours, points: Floats, weights: Floats) -> list[Floats]:
    """Sum the six strain products over points (q, 3) of the unit ball with columns of weights (q, w); returns w arrays (n, 6)."""
    n = len(tumours.x)
    integrals = np.empty((weights.shape[1], n, 6))
    radius = tumours.diameter / 2
    table = np.full(n, n > MAX_TUMOURS_WITHOUT_TABLE) & energies.covers(
        tumours.offset + radius, -tumours.cover, -tumours.depth - radius
    )
    for which, ask in ((table, energies.interpolate), (np.logical_not(table), energies.evaluate)):
        chosen = np.flatnonzero(which)
        for low in range(0, len(chosen), TUMOURS_PER_CHUNK):
            block = chosen[low : low + TUMOURS_PER_CHUNK]
            x, y, height = (points[:, k] * radius[block, None] for k in range(3))
            r, z = np.hypot(tumours.offset[block, None] + x, y), height - tumours.depth[block, None]
            values = ask(r.ravel(), z.ravel()).reshape(6, *r.shape)
            integrals[:, block] = np.einsum("pnq,qw->wnp", values, weights)
    return list(integrals)


@lru_cache(maxsize=8)
def build_half_ball(radial_points: int, height: int, around: int) -> tuple[Floats, Floats]:
    """Build points in the half y > 0 of the unit ball, x away from the axis, z up, with weights that add up to 1, (q, 1)."""
    surface, share = _build_half_sphere(height, around)
    radius, weight = roots_jacobi(radial_points, 0, 2)
    radius, weight = (1 + radius) / 2, weight / weight.sum()
    return (radius[:, None, None] * surface).reshape(-1, 3), np.outer(weight, share[:, 0]).reshape(-1, 1)


def build_whole_ball(radial_points: int, height: int, around: int) -> tuple[Floats, Floats]:
    """Build points in the unit ball, (q, 3), with weights that add up to 1."""
    points, weights = build_half_ball(radial_points, height, around // 2)
    return np.concatenate([points, points * [1, -1, 1]]), np.tile(weights[:, 0] / 2, 2)


@lru_cache(maxsize=8)
def _build_half_sphere(height: int, around: int) -> tuple[Floats, Floats]:
    """Build points on the half y > 0 of the unit sphere, with weights for the means of a function, of z and x times it."""
    z, weight = leggauss(height)
    angle = (np.arange(around) + 0.5) * np.pi / around
    across = np.sqrt(1 - z**2)
    points = np.stack([np.outer(across, np.cos(angle)), np.outer(across, np.sin(angle)), np.outer(z, np.ones(around))], axis=-1)
    points, share = points.reshape(-1, 3), np.repeat(weight / 2, around) / around
    return points, np.stack([share, share * points[:, 2], share * points[:, 0]], axis=1)
