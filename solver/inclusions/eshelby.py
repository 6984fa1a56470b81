"""Compute the strength of an inclusion: its polarisation per strain that the tissue would have at its place.

An ellipsoid of another material in a uniform strain is itself strained uniformly (Eshelby, Proc. R. Soc. A 241 (1957) 376).
With dC = C_object - C_tissue the difference of the stiffnesses, Hill's tensor P of the shape and 1 the identity, the work per
volume that the inclusion adds to two strains eps_i and eps_j is

    eps_i : k : eps_j,   k = dC (1 + P dC)^-1                                                      (IN.1)

and for a sphere (PHYSICS sections 3 and 4)

    k = k_v 1 x 1 + k_d I_dev,   k_v = dK / (1 + alpha dK / K),   k_d = 2 dmu / (1 + beta dmu / mu)
    alpha = (1 + nu) / (3 (1 - nu)),   beta = 2 (4 - 5 nu) / (15 (1 - nu))                      (IN.2)

with K, mu and nu the tissue's bulk modulus, shear modulus and Poisson's ratio, dK and dmu the sphere's moduli less the tissue's,
1 x 1 the product of traces and I_dev the projection on deviators: eps_i : k : eps_j = k_v tr eps_i tr eps_j + k_d e_i:e_j with
the deviators e.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss

from geometry.common.arrays import Floats
from geometry.common.errors import Refusal
from geometry.scenes.probe import Material
from solver.materials.linear import VOIGT_PAIRS, Isotropic, LinearLaw

MAX_ASPECT_RATIO = 20.0  # ratio of an ellipsoid's diameters; above it eq. IN.3 would need too many points


@dataclass(frozen=True)
class Strength:
    """Eq. IN.2 of spheres and its derivatives; arrays of any one shape, Pa.

    Attributes
    ----------
    volume, shear
        k_v and k_d.
    by_log_modulus, by_poisson
        Derivatives of both by ln E and by nu of the spheres.
    """

    volume: Any
    shear: Any
    by_log_modulus: tuple[Any, Any]
    by_poisson: tuple[Any, Any]


def compute_strength(matrix: Material | Isotropic, youngs_modulus: Floats, poisson_ratio: Floats) -> Strength:
    """Return the strength of spheres with given moduli (Pa) and Poisson's ratios, arrays of one shape, in a matrix.

    The matrix is one for all, or each sphere's own in arrays of the same shape.
    """
    E, n = np.asarray(youngs_modulus, dtype=float), np.asarray(poisson_ratio, dtype=float)
    strengths, by_modulus = compute_strengths(matrix.youngs_modulus, matrix.poisson_ratio, E, n)
    # both moduli are proportional to E: the factors are d ln(bulk modulus) / d nu and d ln(shear modulus) / d nu
    by_poisson = by_modulus[0] * 2 / (1 - 2 * n), -by_modulus[1] / (1 + n)
    return Strength(*strengths, by_modulus, by_poisson)


def compute_strengths(modulus: Any, nu: Any, youngs_modulus: Any, poisson_ratio: Any) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """Return k_v and k_d of spheres, eq. IN.2, and their derivatives with respect to ln of the spheres' Young's modulus, Pa.

    ``modulus`` (Pa) and ``nu`` are the matrix's, ``youngs_modulus`` (Pa) and ``poisson_ratio`` the spheres'; all may be complex.
    """
    matrix, body = Isotropic(modulus, nu), Isotropic(youngs_modulus, poisson_ratio)
    bulk, mu, object_bulk, object_mu = matrix.bulk_modulus, matrix.shear_modulus, body.bulk_modulus, body.shear_modulus
    alpha, beta = (1 + nu) / (3 * (1 - nu)), 2 * (4 - 5 * nu) / (15 * (1 - nu))
    # the denominators of IN.2 times K and mu: in this form neither overflows where a difference of moduli is huge
    volume_denominator, shear_denominator = (1 - alpha) * bulk + alpha * object_bulk, (1 - beta) * mu + beta * object_mu
    strengths = (object_bulk - bulk) * bulk / volume_denominator, 2 * (object_mu - mu) * mu / shear_denominator
    return strengths, ((bulk / volume_denominator) ** 2 * object_bulk, 2 * (mu / shear_denominator) ** 2 * object_mu)


def compute_polarisation(matrix: Isotropic, body: LinearLaw, axes: Floats) -> tuple[Floats, Floats]:
    """Return k of an ellipsoid, eq. IN.1, and its derivative by ln E of the body; 6 x 6 matrices, Pa.

    They work on strains (xx, yy, zz, 2 yz, 2 xz, 2 xy) of the frame in which the semi-axes are given.

    Parameters
    ----------
    matrix
        The tissue's law.
    body
        The ellipsoid's law.
    axes
        Semi-axes as columns, shape (3, 3), m.

    Raises
    ------
    Refusal
        An ellipsoid whose longest and shortest diameters are too far apart.
    """
    hill, (stiffness, body_stiffness) = compute_hill_tensor(matrix, axes), (law.build_stiffness() for law in (matrix, body))
    concentration = np.linalg.inv(np.eye(6) + hill @ (body_stiffness - stiffness))  # strain inside per strain far away
    k = (body_stiffness - stiffness) @ concentration
    return (k + k.T) / 2, concentration.T @ body_stiffness @ concentration


def compute_hill_tensor(matrix: Isotropic, axes: Floats) -> Floats:
    """Return Hill's tensor of an ellipsoid as a 6 x 6 matrix from stresses to strains with engineering shears, 1/Pa.

    P_ijkl = 1 / (4 pi) Int sym(n_i G_jk n_l) dS over the unit sphere's xi, with n the direction of A^-T xi, A the semi-axes and
    G = (1 - n n (lam + mu) / (lam + 2 mu)) / mu                                              (IN.3)
    (Mura, Micromechanics of Defects in Solids, 1987, section 11; after the substitution xi = A^T k the weight is uniform).

    Raises
    ------
    Refusal
        See ``compute_polarisation``.
    """
    lengths = np.linalg.svd(axes, compute_uv=False)
    aspect = float(lengths[0] / lengths[-1])
    if aspect > MAX_ASPECT_RATIO:
        raise Refusal("diameters", f"{aspect:.3g} times as long as wide", f"at most {MAX_ASPECT_RATIO:g} times")
    order = 24 + int(12 * aspect)  # long ellipsoids need more points
    points, weights = build_sphere_rule(order, (np.arange(2 * order) + 0.5) * np.pi / order)
    n = np.linalg.solve(axes.T, points.T).T
    n /= np.linalg.norm(n, axis=1)[:, None]
    mu, lam = matrix.shear_modulus, matrix.dilation_modulus
    dyads = np.stack([(n[:, i] * n[:, j]) * (1 if i == j else 2) for i, j in VOIGT_PAIRS], axis=1)  # n_i n_j as a strain
    longitudinal = np.einsum("q,qa,qb->ab", weights, dyads, dyads)
    # sym(n_i delta_jk n_l): the strain of the direction n with each unit vector in turn
    direction_strains = np.zeros((len(n), 6, 3))
    for a, (i, j) in enumerate(VOIGT_PAIRS):
        direction_strains[:, a, i] += n[:, j] * (0.5 if i == j else 1.0)
        direction_strains[:, a, j] += n[:, i] * (0.5 if i == j else 1.0)
    transverse = np.einsum("q,qak,qbk->ab", weights, direction_strains, direction_strains)
    return np.asarray((transverse - (lam + mu) / (lam + 2 * mu) * longitudinal) / mu)


def build_sphere_rule(latitudes: int, angles: Floats) -> tuple[Floats, Floats]:
    """Build q points on the unit sphere, (q, 3), with weights that add up to 1: Gauss in z, equal at all angles about z."""
    heights, weights = leggauss(latitudes)
    return place_on_sphere(heights, angles), np.repeat(weights, len(angles)) / (2 * len(angles))


def place_on_sphere(heights: Floats, angles: Floats) -> Floats:
    """Return points of the unit sphere at all heights z, each at all angles about the z axis, shape (heights angles, 3)."""
    across, z = np.sqrt(1 - heights**2)[:, None], heights[:, None]
    return np.stack([across * np.cos(angles), across * np.sin(angles), z + 0 * angles], axis=-1).reshape(-1, 3)
