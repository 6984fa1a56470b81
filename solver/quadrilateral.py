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

from geometry.errors import SolveError
from geometry.grading import Floats
from solver.shapes import Shapes


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


def gradients(at: Geometry, shapes: Shapes) -> tuple[Floats, Floats, Floats]:
    """Return dN/dr, dN/dz and N/r of all functions at all points, each of shape (n, q, s)."""
    x, y = shapes.slope
    along = [at.inverse[..., 0, k, None] * x + at.inverse[..., 1, k, None] * y for k in (0, 1)]
    return along[0], along[1], shapes.value / at.radius[..., None]


def matrices(at: Geometry, shapes: Shapes) -> tuple[Floats, Floats]:
    """Integrate eps:eps and (P div u)^2, P the projection, over each ring element.

    Returns two arrays of shape (n, 2, s, 2, s), the components r and z before the functions: the stiffness per unit 2 mu
    and per unit lambda.
    """
    by_r, by_z, hoop = gradients(at, shapes)
    shear, volume = (np.empty((len(by_r), 2, by_r.shape[2], 2, by_r.shape[2])) for _ in range(2))
    moments, mass = _dilation(at, shapes, by_r, by_z, hoop)
    root = np.sqrt(at.weight)[..., None]
    for array in (by_r, by_z, hoop):
        array *= root
    rr, zz, rz = _products(by_r, by_r), _products(by_z, by_z), _products(by_z, by_r)
    shear[:, 0, :, 0], shear[:, 1, :, 1] = rr + zz / 2 + _products(hoop, hoop), zz + rr / 2
    shear[:, 0, :, 1], shear[:, 1, :, 0] = rz / 2, rz.transpose(0, 2, 1) / 2
    flat = moments.reshape(len(moments), moments.shape[1], -1)
    volume[:] = (flat.transpose(0, 2, 1) @ np.linalg.solve(mass, flat)).reshape(volume.shape)
    return shear, volume


def _products(a: Floats, b: Floats) -> Floats:
    return a.transpose(0, 2, 1) @ b


def _dilation(at: Geometry, shapes: Shapes, by_r: Floats, by_z: Floats, hoop: Floats) -> tuple[Floats, Floats]:
    """Moments of the dilation of every displacement with every pressure, (n, m, 2, s), and the pressures' mass, (n, m, m)."""
    weighted = (at.weight[..., None] * shapes.pressure).transpose(0, 2, 1)
    moments = np.stack([weighted @ (by_r + hoop), weighted @ by_z], axis=2)
    return moments, weighted @ shapes.pressure


def projected(at: Geometry, shapes: Shapes, dilation: Floats) -> Floats:
    """Project dilations at the Gauss points, shape (n, q, m), onto the pressures."""
    weighted = (at.weight[..., None] * shapes.pressure).transpose(0, 2, 1)
    return np.asarray(shapes.pressure @ np.linalg.solve(weighted @ shapes.pressure, weighted @ dilation))


def lame(youngs_modulus: Any, poisson_ratio: Any) -> tuple[Any, Any]:
    """Return 2 mu and lambda."""
    two_mu = youngs_modulus / (1 + poisson_ratio)
    return two_mu, two_mu * poisson_ratio / (1 - 2 * poisson_ratio)
