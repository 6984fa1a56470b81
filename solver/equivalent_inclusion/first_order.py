"""Compute first-order changes of film forces and charges by tumours: integrals of undisturbed strains over their volume.

By reciprocity a sphere changes the energy products F_ij of the states by

    dF_ij = Int [k_v tr(eps_i) tr(eps_j) + k_d e_i:e_j] dV                                        (EI.1)

with the strains eps_i of the tissue without the sphere, their deviators e_i, and the sphere's strengths k_v and k_d, eq. IN.2 of
``solver/inclusions/eshelby.py`` (PHYSICS section 4). Products of two base states are film forces, those of a film state with a
base state charges (``solver/axisymmetric/film_states.py``). Effects of several spheres add. The derivatives of eq. EI.1 with
respect to the position of the sphere's centre and to its radius are integrals of the same products over its surface (EI.2).

The first order leaves out reflections by surface, blocks, bottom and other tumours; eq. EI.3 bounds its error.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.probe import Material
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.equivalent_inclusion.strain_products import Energies
from solver.inclusions.eshelby import build_sphere_rule, compute_strength
from solver.inclusions.tumours import Strata, Tumours
from solver.materials.linear import Isotropic

TUMOURS_PER_CHUNK = 1000  # tumours at a time, to limit memory
MAX_TUMOURS_WITHOUT_TABLE = 20  # up to so many tumours a table of strain products does not pay
BALL_POINTS = (3, 5, 5)  # along radius, height and half the azimuth: exact for polynomials of degree 5 and more
SURFACE_POINTS = (8, 8)  # along height and half the azimuth
# rho of a sphere ten times as stiff as the tissue whose centre lies one radius deep is about 0.94 (PHYSICS section 4); random
# scenes against ``axisymmetric`` (benchmarks/evaluators/equivalent_inclusion.py) need up to 1.1 for shallow and 1.7 for deep ones
SURFACE_REFLECTION_FACTOR = 1.5
MIN_SHARE = 0.003  # of the effect: minimum of the bound
REFERENCE_STRENGTH = 1.96  # the strength k_d / (2 mu) of that sphere
MAX_REFLECTION = 0.9  # of rho


@dataclass(frozen=True)
class Effects:
    """Changes of the energy products of the s states by n spheres, each alone.

    Attributes
    ----------
    products
        Eq. EI.1, symmetric, shape (n, s, s).
    derivatives
        Derivatives of ``products`` with respect to quantities of each sphere, shape (n, s, s): the logarithm of its
        youngs_modulus, and where requested of its diameter and its depth, its poisson_ratio, and its offset from the probe's
        axis, per m.
    """

    products: Floats
    derivatives: dict[str, Floats]

    @property
    def forces(self) -> Floats:
        """Changes of the film forces, N/m, shape (n, 2, 2)."""
        return self.products[:, :2, :2]


def compute_effects(energies: Energies, hosts: Material | Isotropic, tumours: Tumours, places: bool = False) -> Effects:
    """Compute the first-order effect of each of n spheres on film forces and charges, with its derivatives.

    Parameters
    ----------
    energies
        Strain products of the states.
    hosts
        The tissue's material about the spheres: one for all, or each sphere's own in arrays (n,).
    tumours
        The spheres, arrays of shape (n,).
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
    products = _combine_products(energies, inside, strength.volume, strength.shear)
    derivatives = {"youngs_modulus": _combine_products(energies, inside, *strength.by_log_modulus)}
    if places:
        surface_mean, upward_moment, outward_moment = (
            _combine_products(energies, part * (4 * np.pi * radius**2)[:, None], strength.volume, strength.shear)
            for part in _integrate_products(energies, tumours, *_build_half_sphere(*SURFACE_POINTS))
        )
        derivatives |= {
            "poisson_ratio": _combine_products(energies, inside, *strength.by_poisson),
            "depth": -upward_moment * tumours.depth[:, None, None],
            "offset": outward_moment,
            "diameter": surface_mean * radius[:, None, None],
        }
    return Effects(products, derivatives)


def _combine_products(energies: Energies, products: Floats, volume: Floats, shear: Floats) -> Floats:
    """Combine strain products as in eq. EI.1 to symmetric matrices, shape (n, s, s).

    Of the ``products``, (n, 2 p), the p of traces are times ``volume``, k_v, the p of deviators times ``shear``, k_d.
    """
    traces, deviators = np.split(products, 2, axis=1)
    return np.asarray((volume[:, None] * traces + shear[:, None] * deviators)[:, energies.pair_index])


def _integrate_products(energies: Energies, tumours: Tumours, points: Floats, weights: Floats) -> list[Floats]:
    """Sum the strain products over the points of n spheres with weights; return one array (n, 2 p) for each column of these.

    ``points``, (q, 3), lie in the unit ball; ``weights`` have w columns, (q, w).
    """
    n = len(tumours.x)
    integrals = np.empty((weights.shape[1], n, 2 * len(energies.pairs)))
    radius = tumours.diameter / 2
    by_table = np.full(n, n > MAX_TUMOURS_WITHOUT_TABLE) & energies.covers(
        tumours.offset + radius, -tumours.cover, -tumours.depth - radius
    )
    for is_chosen, evaluate in ((by_table, energies.interpolate), (np.logical_not(by_table), energies.evaluate)):
        chosen = np.flatnonzero(is_chosen)
        for low in range(0, len(chosen), TUMOURS_PER_CHUNK):
            block = chosen[low : low + TUMOURS_PER_CHUNK]
            x, y, height = (points[:, k] * radius[block, None] for k in range(3))
            r, z = np.hypot(tumours.offset[block, None] + x, y), height - tumours.depth[block, None]
            values = evaluate(r.ravel(), z.ravel()).reshape(-1, *r.shape)
            integrals[:, block] = np.einsum("pnq,qw->wnp", values, weights)
    return list(integrals)


@lru_cache(maxsize=8)
def build_half_ball(radial_points: int, height: int, around: int) -> tuple[Floats, Floats]:
    """Build points (q, 3) in the half y > 0 of the unit ball, x away from the axis, z up, and weights (q, 1) that add up to 1."""
    surface, surface_weights = _build_half_sphere(height, around)
    radius, weight = _build_radial_rule(radial_points)
    return (radius[:, None, None] * surface).reshape(-1, 3), np.outer(weight, surface_weights[:, 0]).reshape(-1, 1)


def _build_radial_rule(count: int) -> tuple[Floats, Floats]:
    """Build the Gauss rule on 0 < r < 1 with the weight r^2 of the volume; weights add up to 1.

    By Golub and Welsch, Math. Comput. 23 (1969) 221, from the recurrence of Jacobi polynomials: SciPy's takes longer to load.
    """
    n, k = np.arange(count), np.arange(1, count)
    diagonal = 1 / ((n + 1) * (n + 2))
    beside = k * (k + 2) / ((k + 1) * np.sqrt((2 * k + 1) * (2 * k + 3)))
    nodes, vectors = np.linalg.eigh(np.diag(diagonal) + np.diag(beside, 1) + np.diag(beside, -1))
    return (1 + nodes) / 2, vectors[0] ** 2


def build_whole_ball(radial_points: int, height: int, around: int) -> tuple[Floats, Floats]:
    """Build points in the unit ball, (q, 3), with weights that add up to 1."""
    points, weights = build_half_ball(radial_points, height, around // 2)
    return np.concatenate([points, points * [1, -1, 1]]), np.tile(weights[:, 0] / 2, 2)


@lru_cache(maxsize=8)
def _build_half_sphere(height: int, around: int) -> tuple[Floats, Floats]:
    """Build points (q, 3) on the half y > 0 of the unit sphere, with weights (q, 3) for three means over it.

    The means are those of a function f, of z f and of x f.
    """
    points, weights = build_sphere_rule(height, (np.arange(around) + 0.5) * np.pi / around)
    return points, np.stack([weights, weights * points[:, 2], weights * points[:, 0]], axis=1)


def bound_first_order_share(base: Undisturbed, tumours: Tumours) -> Floats:
    """Bound the relative error of each tumour's first-order effect, shape (n, t), by rho / (1 - rho) (EI.3).

    rho is the fraction of the tumour's scattered field that is reflected back to it. The first order leaves out all reflections,
    whose geometric series has this sum.
    """
    rho = np.minimum(estimate_reflection(base, tumours), MAX_REFLECTION)
    return np.asarray(rho / (1 - rho) + base.bound_field_error(tumours) + MIN_SHARE)


def bound_first_order_error(relative_errors: Floats, changes: Floats) -> Floats:
    """Bound the errors of each film's force and, with films, charge, (n, s).

    By the Cauchy-Schwarz inequality the reflected fields change the total of state i by at most that fraction of
    sqrt(dF_ii dF_UU), where dF are a tumour's changes of the energy products and U is the sum of both base states. The bounds of
    all tumours add up.

    Parameters
    ----------
    relative_errors
        Of each tumour's effect, shape (n, t).
    changes
        Of the energy products by each tumour, shape (n, t, s, s).
    """
    film_changes = np.abs(np.diagonal(changes, axis1=2, axis2=3))
    total_changes = np.abs(changes[..., :2, :2].sum(axis=(2, 3)))[..., None]
    return np.asarray((relative_errors[..., None] * np.sqrt(film_changes * total_changes)).sum(axis=1))


def estimate_reflection(base: Undisturbed, tumours: Tumours) -> Floats:
    """Estimate the fraction rho of each tumour's field that surface, bottom, side and other tumours reflect to it, (n, t)."""
    hosts = base.strata.find_hosts(tumours.depth)
    sphere_strength = compute_strength(hosts, tumours.youngs_modulus, tumours.poisson_ratio)
    nu, bulk = hosts.poisson_ratio, hosts.bulk_modulus
    alpha = (1 + nu) / (3 * (1 - nu))
    relative_strength = (
        np.abs(sphere_strength.shear) / (hosts.two_mu * REFERENCE_STRENGTH) + np.abs(sphere_strength.volume) * (1 - alpha) / bulk
    )  # shear and volume; of a hole 0.85 + 1
    radius = tumours.diameter / 2
    section = base.field.states.model.section
    floor_distance, side_distance = section.tissue_depth - tumours.depth, section.tissue_radius - tumours.offset
    # a field falls off with the cube of the distance
    proximity = sum((radius / np.maximum(distance, radius)) ** 3 for distance in (tumours.depth, floor_distance, side_distance))
    return np.asarray(
        SURFACE_REFLECTION_FACTOR
        * relative_strength
        * (proximity + _sum_interface_reflections(base.strata, tumours, radius) + _sum_neighbour_reflections(tumours, radius))
    )


def _sum_interface_reflections(strata: Strata, tumours: Tumours, radius: Floats) -> Floats:
    """Sum the reflections of each tumour's field by interfaces between layers, (n, t), in the unit of ``proximity``.

    Each is the reflection by a surface at that depth, times the contrast of the materials on both sides.
    """
    pairs = zip(strata.interfaces, strata.contrasts, strict=True)
    reflections = [contrast * (radius / np.maximum(np.abs(tumours.depth - depth), radius)) ** 3 for depth, contrast in pairs]
    return np.asarray(sum(reflections, np.zeros(tumours.shape)))


def _sum_neighbour_reflections(tumours: Tumours, radius: Floats) -> Floats:
    """Sum the reflections of each tumour's field by the other tumours of its set, (n, t), in the unit of ``proximity``.

    One tumour at a time is compared with all, to limit memory.
    """
    places, n, t = np.stack([tumours.x, tumours.y, tumours.depth]), *tumours.shape
    reflections = np.zeros((n, t))
    for i in range(t if t > 1 else 0):
        distance = np.sqrt(((places - places[:, :, i : i + 1]) ** 2).sum(axis=0))
        reflection = (radius[:, i : i + 1] * radius) ** 1.5 / np.maximum(distance, radius[:, i : i + 1] + radius) ** 3
        reflection[:, i] = 0.0
        reflections[:, i] = reflection.sum(axis=1)
    return reflections
