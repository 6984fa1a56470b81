"""Axisymmetric elasticity on quadrilaterals of any order: element matrices, all at once.

Displacements are polynomials of order p in each direction; the volumetric strain is projected onto
polynomials of total degree p - 1 of each element (the Qp-P(p-1) pair with its pressure eliminated),
which keeps the matrix symmetric positive definite and does not lock as Poisson's ratio goes to 1/2
(Boffi, Brezzi & Fortin, Mixed Finite Element Methods and Applications, 2013, section 8.6.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import SolveError
from solver.axisymmetric.shape_functions import Shapes


@dataclass(frozen=True)
class Geometry:
    """Elements at their Gauss points.

    Attributes:
        radius: r, shape (n, q).
        weight: 2 pi r times area, shape (n, q).
        inverse: of the Jacobian, d(u, v) / d(r, z), shape (n, q, 2, 2).
    """

    radius: Floats
    weight: Floats
    inverse: Floats

    def of(self, chosen: Ints) -> Geometry:
        """Return the geometry of some of the elements."""
        return Geometry(self.radius[chosen], self.weight[chosen], self.inverse[chosen])


def geometry(nodes: Floats, shapes: Shapes) -> Geometry:
    """Return the elements' geometry from their nodes, shape (n, s, 2).

    Raises:
        SolveError: an element is turned inside out.
    """
    radius = nodes[..., 0] @ shapes.geometry.T
    (a, b), (c, d) = ([nodes[..., x] @ shapes.tangents[k].T for k in (0, 1)] for x in (0, 1))
    area = a * d - b * c
    if not np.all(area > 0) or not np.all(radius > 0):
        raise SolveError("the mesh has a cell without area: lengths of the scene are too far apart")
    inverse = np.stack([np.stack([d, -b], axis=-1), np.stack([-c, a], axis=-1)], axis=-2) / area[..., None, None]
    return Geometry(radius, 2 * np.pi * radius * area * shapes.weights, inverse)


def gradients(at: Geometry, shapes: Shapes, u: Floats) -> tuple[tuple[Floats, ...], Floats]:
    """Return u_r,r, u_r,z, u_z,r, u_z,z and u_r / r at all points, (n, q, m) each, of values u, (n, 2, s, m)."""
    (xr, xz), (yr, yz) = (at.inverse[..., k, :, None].transpose(2, 0, 1, 3) for k in (0, 1))
    slopes: list[Floats] = []
    for component in (0, 1):
        by_x, by_y = (slope @ u[:, component] for slope in shapes.slope)
        slopes += [xr * by_x + yr * by_y, xz * by_x + yz * by_y]
    return tuple(slopes), (shapes.value @ u[:, 0]) / at.radius[..., None]


def matrices(at: Geometry, shapes: Shapes) -> tuple[Floats, Floats]:
    """Integrate eps:eps and (P div u)^2, P the projection, over each ring element.

    Returns two arrays of shape (n, 2, s, 2, s), the components r and z before the functions: the stiffness per unit 2 mu
    and per unit lambda. Integrals are products of metric coefficients, (n, points), with tables of the functions'
    products, so that they run at the speed of large matrix products.
    """
    n, s, table = len(at.weight), len(shapes.degrees), shapes.products
    (xr, xz), (yr, yz) = (at.inverse[..., k, :].transpose(2, 0, 1) for k in (0, 1))  # x, y: the unit square's; r, z
    w, q = at.weight, at.weight.shape[1]
    shear = np.empty((n, 2, s, 2, s))
    rr = np.concatenate([w / at.radius**2, *(w * (a * b + c * d / 2) for a, b, c, d in _pairs(xr, yr, xz, yz))], axis=1)
    zz = np.concatenate([w * (a * b + c * d / 2) for a, b, c, d in _pairs(xz, yz, xr, yr)], axis=1)
    rz = np.concatenate([w / 2 * a * b for a in (xz, yz) for b in (xr, yr)], axis=1)
    shear[:, 0, :, 0] = (rr @ table.even).reshape(n, s, s)
    shear[:, 1, :, 1] = (zz @ table.even[q:]).reshape(n, s, s)
    shear[:, 0, :, 1] = (rz @ table.odd).reshape(n, s, s)
    shear[:, 1, :, 0] = shear[:, 0, :, 1].transpose(0, 2, 1)
    moments = np.empty((n, shapes.pressure.shape[1], 2, s))
    moments[:, :, 0] = (np.concatenate([w * xr, w * yr, w / at.radius], axis=1) @ table.dilation).reshape(n, -1, s)
    moments[:, :, 1] = (np.concatenate([w * xz, w * yz], axis=1) @ table.dilation[: 2 * q]).reshape(n, -1, s)
    flat = moments.reshape(n, -1, 2 * s)
    mass = (w @ table.mass).reshape(n, flat.shape[1], -1)
    volume = flat.transpose(0, 2, 1) @ (np.linalg.inv(mass) @ flat)
    return shear, volume.reshape(shear.shape)


def _pairs(x: Floats, y: Floats, also_x: Floats, also_y: Floats) -> tuple[tuple[Floats, ...], ...]:
    """Factors of X X, X Y + Y X and Y Y in a product of two slopes, and of the same by the other coordinate."""
    return (x, x, also_x, also_x), (x, y, also_x, also_y), (y, y, also_y, also_y)


def dilations(at: Geometry, shapes: Shapes, m: int = 0) -> Floats:
    """From values U, V, W of fields of azimuthal order m to coefficients of their projected dilation, (n, pressures, 3, s).

    div u = U,r + (U + m V) / r + W,z. With nearly incompressible tissue the projection, not div u itself, is what balances.
    """
    (xr, xz), (yr, yz) = (at.inverse[..., k, :, None].transpose(2, 0, 1, 3) for k in (0, 1))
    over = shapes.value / at.radius[..., None]
    parts = xr * shapes.slope[0] + yr * shapes.slope[1] + over, m * over, xz * shapes.slope[0] + yz * shapes.slope[1]
    weighted = (at.weight[..., None] * shapes.pressure).transpose(0, 2, 1)
    moments = weighted @ np.concatenate(parts, axis=2)
    coefficients = np.linalg.solve(weighted @ shapes.pressure, moments)
    return np.asarray(coefficients.reshape(*coefficients.shape[:2], 3, -1))


def projected(at: Geometry, shapes: Shapes, dilation: Floats) -> Floats:
    """Project dilations at the Gauss points, shape (n, q, m), onto the pressures."""
    weighted = (at.weight[..., None] * shapes.pressure).transpose(0, 2, 1)
    return np.asarray(shapes.pressure @ np.linalg.solve(weighted @ shapes.pressure, weighted @ dilation))


def lame(youngs_modulus: Any, poisson_ratio: Any) -> tuple[Any, Any]:
    """Return 2 mu and lambda."""
    two_mu = youngs_modulus / (1 + poisson_ratio)
    return two_mu, two_mu * poisson_ratio / (1 - 2 * poisson_ratio)
