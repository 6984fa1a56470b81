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
import skfem
from numpy.polynomial import legendre
from numpy.typing import NDArray

from geometry.grading import Floats
from geometry.meridian import Body, MeridianMesh

Ints = NDArray[np.int64]
CHUNK = 200  # elements integrated at once, which bounds the memory


@dataclass(frozen=True)
class Elements:
    """Elements with their numbering and the parts of their stiffness that do not depend on moduli.

    ``s`` is the number of shape functions of an element, (p+1)^2; the first 4 p of them, its
    ``skeleton``, belong to corners and edges, and they come first in the whole numbering too.

    Attributes:
        functions: element to shape function numbers, shape (n, s); blocks and tissue have their own on z = 0.
        ends: the two ends (r, z) of the edge that a skeleton function belongs to, twice the same point
            for a corner; m, shape (skeleton functions, 2, 2).
        degree: 1 for a corner's function, 2 to p on an edge; shape (skeleton functions,).
        shear: stiffness per unit 2 mu, shape (n, 2 s, 2 s), in m; dofs in the order u_r, u_z of each function.
        volume: stiffness per unit lambda, likewise.
        body: the body of each element, shape (n,).
    """

    functions: Ints
    ends: Floats
    degree: Ints
    shear: Floats
    volume: Floats
    body: Ints

    @property
    def skeleton(self) -> int:
        """Number of shape functions on an element's corners and edges, 4 p."""
        return 4 * int(self.degree.max())


def elements(mesh: MeridianMesh, order: int) -> Elements:
    """Number the shape functions of a mesh, ``order`` >= 3, and integrate its element matrices."""
    basis = skfem.Basis(_skfem_mesh(mesh), skfem.ElementQuadP(order), intorder=2 * order + 2)
    ends, degree = _places(basis, order)
    shear, volume = _matrices(basis, order)
    return Elements(basis.element_dofs.T.astype(np.int64), ends, degree, shear, volume, mesh.body)


def lame(youngs_modulus: Floats, poisson_ratio: Floats) -> tuple[Floats, Floats]:
    """Return 2 mu and lambda."""
    two_mu = youngs_modulus / (1 + poisson_ratio)
    return two_mu, two_mu * poisson_ratio / (1 - 2 * poisson_ratio)


def _skfem_mesh(mesh: MeridianMesh) -> skfem.MeshQuad2:
    """Join cells of one part (tissue with inclusion, inner, outer) where their corners coincide."""
    part = np.where(mesh.body == Body.INCLUSION, Body.TISSUE, mesh.body)
    keys = np.concatenate([mesh.cells[:, :4], np.broadcast_to(part[:, None, None], (len(part), 4, 1))], axis=2).reshape(-1, 3)
    order = np.lexsort(keys.T)
    new = np.concatenate([[True], np.any(np.diff(keys[order], axis=0) != 0, axis=1)])
    number = np.empty(len(keys), dtype=np.int64)
    number[order] = np.cumsum(new) - 1
    vertices, corners = keys[order][new][:, :2].T, number.reshape(-1, 4).T
    straight = skfem.MeshQuad(np.ascontiguousarray(vertices), np.ascontiguousarray(corners), sort_t=False)
    curved = skfem.MeshQuad2.from_mesh(straight)
    dofs = skfem.Dofs(curved, skfem.ElementQuad2()).element_dofs
    places = np.zeros((2, dofs.max() + 1))
    places[:, dofs.T] = np.moveaxis(mesh.cells, 2, 0)
    return skfem.MeshQuad2(places, curved.t, sort_t=False)


def _places(basis: Any, order: int) -> tuple[Floats, Ints]:
    """Where each shape function lives, and its degree along its edge."""
    corners = basis.mesh.p.T
    size = basis.nodal_dofs.size + basis.facet_dofs.size
    ends, degree = np.zeros((size, 2, 2)), np.zeros(size, dtype=np.int64)
    ends[basis.nodal_dofs[0]] = corners[: basis.nodal_dofs.shape[1], None]
    degree[basis.nodal_dofs[0]] = 1
    for k in range(order - 1):
        ends[basis.facet_dofs[k]] = corners[basis.mesh.facets.T]
        degree[basis.facet_dofs[k]] = k + 2
    return ends, degree


def _edge_signs(basis: Any, order: int) -> Floats:
    """Signs that make an edge's odd functions the same from both sides: along the edge from its lower corner number.

    Shape (elements, s); scikit-fem's functions run along the element's own axes.
    """
    t = basis.mesh.t
    signs = np.ones((t.shape[1], (order + 1) ** 2))
    for edge, (start, end) in enumerate(((0, 1), (1, 2), (3, 2), (0, 3))):
        against = t[start] > t[end]
        for degree in range(3, order + 1, 2):
            signs[against, 4 + edge * (order - 1) + degree - 2] = -1.0
    return signs


def _matrices(basis: Any, order: int) -> tuple[Floats, Floats]:
    """Integrate 2 mu eps:eps and lambda (P div u)^2 over each ring element, P the projection."""
    value = np.stack([np.broadcast_to(np.asarray(field[0]), basis.dx.shape) for field in basis.basis], axis=-1)
    slope = np.stack([field[0].grad for field in basis.basis], axis=-1)  # (2, n, quadrature, s)
    signs = _edge_signs(basis, order)[:, None]
    radius = np.asarray(basis.global_coordinates())[0]
    weight = 2 * np.pi * radius * basis.dx
    pressure = _pressure_functions(basis.X, order)
    parts = []
    for low in range(0, len(weight), CHUNK):
        at = slice(low, low + CHUNK)
        parts.append(_chunk(value[at] * signs[at], slope[:, at] * signs[at], radius[at], weight[at], pressure))
    shear, volume = zip(*parts, strict=True)
    return np.concatenate(shear), np.concatenate(volume)


def _pressure_functions(X: Floats, order: int) -> Floats:
    """Products of Legendre polynomials of total degree below ``order``, shape (quadrature, order (order + 1) / 2)."""
    along, across = (legendre.legvander(2 * x - 1, order - 1) for x in X)
    return np.stack([along[:, i] * across[:, j] for i in range(order) for j in range(order - i)], axis=-1)


def _chunk(value: Floats, slope: Floats, radius: Floats, weight: Floats, pressure: Floats) -> tuple[Floats, Floats]:
    n, points, s = value.shape
    strain = np.zeros((n, 4, points, s, 2))  # rr, zz, hoop, sqrt(2) rz: eps:eps is a plain sum of squares
    strain[:, 0, ..., 0], strain[:, 1, ..., 1] = slope[0], slope[1]
    strain[:, 2, ..., 0] = value / radius[..., None]
    strain[:, 3, ..., 0], strain[:, 3, ..., 1] = slope[1] / np.sqrt(2), slope[0] / np.sqrt(2)
    dilation = strain[:, :3].sum(axis=1).reshape(n, points, 2 * s)
    weighted = weight[..., None] * pressure
    moments = weighted.transpose(0, 2, 1) @ dilation
    mass = weighted.transpose(0, 2, 1) @ pressure
    strain *= np.sqrt(weight)[:, None, :, None, None]
    flat = strain.reshape(n, 4 * points, 2 * s)
    return flat.transpose(0, 2, 1) @ flat, moments.transpose(0, 2, 1) @ np.linalg.solve(mass, moments)
