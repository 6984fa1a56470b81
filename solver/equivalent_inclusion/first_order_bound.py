"""Bound the error of the first order, which leaves out reflections by surface, blocks, floor and other tumours."""

from __future__ import annotations

import numpy as np

from geometry.common.arrays import Floats
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed
from solver.inclusions.eshelby import compute_strength
from solver.inclusions.strata import Strata
from solver.inclusions.tumours import Tumours

# rho of a sphere ten times as stiff as the tissue whose centre lies one radius deep is about 0.94 (PHYSICS section 4); random
# scenes against ``axisymmetric`` (benchmarks/evaluators/equivalent_inclusion.py) need up to 1.1 for shallow and 1.7 for deep ones
SURFACE_REFLECTION_FACTOR = 1.5
MIN_SHARE = 0.003  # of the effect: minimum of the bound
REFERENCE_STRENGTH = 1.96  # the strength k_d / (2 mu) of that sphere
MAX_REFLECTION = 0.9  # of rho


def bound_first_order_share(base: Undisturbed, tumours: Tumours) -> Floats:
    """Bound the relative error of each tumour's first-order effect, shape (n, t), by rho / (1 - rho) (EI.3).

    rho is the fraction of the tumour's scattered field that is reflected back to it. The first order leaves out all reflections,
    whose geometric series has this sum.
    """
    rho = np.minimum(estimate_reflection(base, tumours), MAX_REFLECTION)
    return np.asarray(rho / (1 - rho) + base.bound_field_error(tumours) + MIN_SHARE)


def bound_first_order_error(share: Floats, changes: Floats) -> Floats:
    """Bound the errors of each film's total, (n, 2), from tumours' relative errors (n, t) and changes (n, t, 2, 2), N/m.

    By the Cauchy-Schwarz inequality the reflected fields change film i's total by at most that fraction of sqrt(dF_ii dF_UU),
    where dF are a tumour's changes of the film forces and U is the sum of both base states. The bounds of all tumours add up.
    """
    single = np.abs(np.diagonal(changes, axis1=2, axis2=3))
    whole = np.abs(changes.sum(axis=(2, 3)))[..., None]
    return np.asarray((share[..., None] * np.sqrt(single * whole)).sum(axis=1))


def estimate_reflection(base: Undisturbed, tumours: Tumours) -> Floats:
    """Estimate the fraction rho of each tumour's field that surface, floor, side and other tumours reflect to it, (n, t)."""
    hosts = base.strata.find_hosts(tumours.depth)
    sphere_strength = compute_strength(hosts, tumours.youngs_modulus, tumours.poisson_ratio)
    nu, bulk = hosts.poisson_ratio, hosts.bulk_modulus
    alpha = (1 + nu) / (3 * (1 - nu))
    strong = (
        np.abs(sphere_strength.shear) / (hosts.two_mu * REFERENCE_STRENGTH) + np.abs(sphere_strength.volume) * (1 - alpha) / bulk
    )  # of a hole: 0.85 + 1
    radius = tumours.diameter / 2
    section = base.field.states.model.section
    floor_distance, side_distance = section.tissue_depth - tumours.depth, section.tissue_radius - tumours.offset
    proximity = sum((radius / np.maximum(distance, radius)) ** 3 for distance in (tumours.depth, floor_distance, side_distance))
    return np.asarray(
        SURFACE_REFLECTION_FACTOR
        * strong
        * (proximity + _sum_interface_reflections(base.strata, tumours, radius) + _sum_neighbour_reflections(tumours, radius))
    )


def _sum_interface_reflections(strata: Strata, tumours: Tumours, radius: Floats) -> Floats:
    """Sum the reflections of interfaces between layers: each is that of a surface times the contrast of both sides."""
    pairs = zip(strata.interfaces, strata.contrasts, strict=True)
    shares = [unlike * (radius / np.maximum(np.abs(tumours.depth - depth), radius)) ** 3 for depth, unlike in pairs]
    return np.asarray(sum(shares, np.zeros(tumours.shape)))


def _sum_neighbour_reflections(tumours: Tumours, radius: Floats) -> Floats:
    """Sum the reflections of other tumours, one tumour against all at a time to limit memory."""
    place, n, t = np.stack([tumours.x, tumours.y, tumours.depth]), *tumours.shape
    shares = np.zeros((n, t))
    for i in range(t if t > 1 else 0):
        distance = np.sqrt(((place - place[:, :, i : i + 1]) ** 2).sum(axis=0))
        share = (radius[:, i : i + 1] * radius) ** 1.5 / np.maximum(distance, radius[:, i : i + 1] + radius) ** 3
        share[:, i] = 0.0
        shares[:, i] = share.sum(axis=1)
    return shares
