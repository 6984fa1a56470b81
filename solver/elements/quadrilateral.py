"""Integrate axisymmetric elasticity on quadrilaterals of any order: all element matrices at once.

Displacements are polynomials of order p in each direction; the volumetric strain is projected onto
polynomials of total degree p - 1 of each element (the Qp-P(p-1) pair with its pressure eliminated),
which keeps the matrix symmetric positive definite and does not lock as Poisson's ratio goes to 1/2
(Boffi, Brezzi & Fortin, Mixed Finite Element Methods and Applications, 2013, section 8.6.3).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dtrsm
from scipy.linalg.lapack import dpotrf

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import SolveError
from solver.elements.shape_functions import Shapes
from solver.materials.linear import Isotropic


@dataclass(frozen=True)
class Geometry:
    """The geometry of elements at their Gauss points.

    Attributes
    ----------
    radius
        r at the q points of n elements, m, shape (n, q).
    weight
        Quadrature weights: 2 pi r times area, m^3, shape (n, q).
    inverse
        Inverse of the Jacobian: d(u, v) / d(r, z) with u, v on the unit square, 1/m, shape (n, q, 2, 2).
    """

    radius: Floats
    weight: Floats
    inverse: Floats

    def turn_derivatives(self, by_x: Floats, by_y: Floats) -> tuple[Floats, Floats]:
        """Return derivatives by r and z of m fields at the Gauss points from those by x and y of the unit square, (n, q, m)."""
        (xr, xz), (yr, yz) = (self.inverse[..., k, :, None].transpose(2, 0, 1, 3) for k in (0, 1))
        return xr * by_x + yr * by_y, xz * by_x + yz * by_y

    def select(self, chosen: Ints | slice) -> Geometry:
        """Return the geometry of the elements ``chosen``, by their numbers."""
        return Geometry(self.radius[chosen], self.weight[chosen], self.inverse[chosen])


@dataclass(frozen=True)
class Blocks:
    """Blocks of element matrices: functions on corners and edges (outside), and functions within the element (inside).

    Attributes
    ----------
    outside
        Forces on the outside from values of the outside, shape (n, c 4 p, c 4 p) for c components.
    across
        Forces on the inside from values of the outside, shape (n, c (p-1)^2, c 4 p).
    inside
        Forces on the inside from values of the inside, shape (n, c (p-1)^2, c (p-1)^2).
    """

    outside: Floats
    across: Floats
    inside: Floats

    @classmethod
    def from_matrices(cls, whole: Floats, skeleton: int) -> Blocks:
        """Split matrices of n elements with c components and s functions, shape (n, c, s, c, s).

        The first ``skeleton`` functions are those on corners and edges.
        """
        n, c, s = whole.shape[:3]
        edge, inner = c * skeleton, c * (s - skeleton)
        low, high = slice(None, skeleton), slice(skeleton, None)
        outside = whole[:, :, low, :, low].reshape(n, edge, edge)
        across = whole[:, :, high, :, low].reshape(n, inner, edge)
        return cls(outside, across, whole[:, :, high, :, high].reshape(n, inner, inner))

    def condense(self) -> Condensed:
        """Eliminate the inside of each element."""
        return Condensed.from_blocks([self], len(self.outside))


@dataclass(frozen=True)
class Condensed:
    """Element matrices after elimination of the functions within each element.

    Attributes
    ----------
    stiffness
        Stiffness of the functions on corners and edges, shape (n, c 4 p, c 4 p).
    upper
        Cholesky factors U of the insides, U^T U, shape (n, c (p-1)^2, c (p-1)^2); entries below the diagonal are undefined.
    half
        U^-T times ``Blocks.across``.
    """

    stiffness: Floats
    upper: Floats
    half: Floats

    @classmethod
    def from_blocks(cls, parts: Iterable[Blocks], count: int) -> Condensed:
        """Eliminate the insides by Cholesky's method, with half of the operations of Gauss's.

        Parameters
        ----------
        parts
            Matrices of some elements at a time, so that not all are in memory together.
        count
            Number of all elements.

        Raises
        ------
        LinAlgError
            An inside is not positive definite to rounding.
        """
        whole: Condensed | None = None
        done = 0
        for blocks in parts:
            if whole is None:
                # in the order of stiffness, upper and half
                shapes = (matrix.shape[1:] for matrix in (blocks.outside, blocks.inside, blocks.across))
                whole = cls(*(np.empty((count, *shape)) for shape in shapes))
            end = done + len(blocks.outside)
            whole._eliminate(blocks, slice(done, end))
            done = end
        assert whole is not None
        return whole

    def _eliminate(self, blocks: Blocks, elements: slice) -> None:
        """Eliminate the insides of some elements and store the results in their place among all elements.

        NumPy's rows are LAPACK's columns: transposes are passed, lower stands for upper, and nothing is copied twice.
        """
        reduced, upper, half = self.stiffness[elements], self.upper[elements], self.half[elements]
        upper[:], half[:] = blocks.inside, blocks.across
        for inside, across in zip(upper, half, strict=True):  # in place: inside becomes U, across U^-T across
            _, info = dpotrf(inside.T, lower=1, clean=0, overwrite_a=1)
            if info:
                raise np.linalg.LinAlgError("an element's inside is not positive definite")
            dtrsm(1.0, inside.T, across.T, side=1, lower=1, trans_a=1, overwrite_b=1)
        np.subtract(blocks.outside, half.transpose(0, 2, 1) @ half, out=reduced)

    def compute_recovery(self, chosen: Ints | slice = slice(None)) -> Floats:
        """Return the matrices that give inside values from those on corners and edges: inside = recovery @ edge.

        They are those of the elements ``chosen``, by their numbers; shape (n, c (p-1)^2, c 4 p).
        """
        pairs = zip(self.upper[chosen], self.half[chosen], strict=True)
        return np.array([dtrsm(-1.0, upper.T, half.T, side=1, lower=1).T for upper, half in pairs])


def compute_geometry(nodes: Floats, shapes: Shapes) -> Geometry:
    """Return the elements' geometry at the Gauss points from their nodes, shape (n, s, 2).

    Raises
    ------
    SolveError
        An element has no area or is inverted.
    """
    radius = nodes[..., 0] @ shapes.geometry.T
    # the Jacobian ((a, b), (c, d)) = d(r, z) / d(u, v), and its determinant: the area per area of the unit square
    (a, b), (c, d) = ([nodes[..., x] @ shapes.tangents[k].T for k in (0, 1)] for x in (0, 1))
    area = a * d - b * c
    if not np.all(area > 0) or not np.all(radius > 0):
        raise SolveError("the mesh has a cell without area: lengths of the scene are too far apart")
    inverse = np.stack([np.stack([d, -b], axis=-1), np.stack([-c, a], axis=-1)], axis=-2) / area[..., None, None]
    return Geometry(radius, 2 * np.pi * radius * area * shapes.weights, inverse)


def compute_gradients(geometry: Geometry, shapes: Shapes, u: Floats) -> tuple[tuple[Floats, ...], Floats]:
    """Return the displacement gradients at the Gauss points of all elements.

    Parameters
    ----------
    geometry, shapes
        Geometry and functions of the elements.
    u
        Coefficients of the functions for u_r and u_z in m states, shape (n, 2, s, m).

    Returns
    -------
    tuple
        The four derivatives u_r,r, u_r,z, u_z,r and u_z,z, and the hoop strain u_r / r; shape (n, q, m) each.
    """
    (rr, rz), (zr, zz) = (geometry.turn_derivatives(*(table @ u[:, k] for table in shapes.derivative)) for k in (0, 1))
    return (rr, rz, zr, zz), (shapes.value @ u[:, 0]) / geometry.radius[..., None]


def integrate_matrices(geometry: Geometry, shapes: Shapes) -> tuple[Floats, Floats]:
    """Integrate eps:eps and (P div u)^2 over each ring element, eps the strain and P the projection onto the pressures.

    Returns two arrays of shape (n, 2, s, 2, s), the components r and z before the functions: the stiffness per unit 2 mu
    and per unit lambda.
    """
    unit_moduli, volume = np.ones(len(geometry.weight)), integrate_volumetric(geometry, shapes)
    return _integrate_shear(geometry, shapes, unit_moduli).take(shapes.tables.stiffness, axis=1).reshape(volume.shape), volume


def integrate_volumetric(geometry: Geometry, shapes: Shapes) -> Floats:
    """Return the second array of ``integrate_matrices`` alone: the stiffness per unit lambda."""
    dilations, inverse = _integrate_dilations(geometry, shapes)
    moments = dilations.take(shapes.tables.moments, axis=1)
    volume = moments.transpose(0, 2, 1) @ (inverse @ moments)
    return np.asarray(volume.reshape(len(volume), *(2, len(shapes.degrees)) * 2))


def integrate_stiffness(geometry: Geometry, shapes: Shapes, law: Isotropic) -> Blocks:
    """Return the blocks of the elements' stiffness matrices; ``law`` holds the moduli of each element, shape (n,)."""
    places = shapes.places_in_sums
    dilations, inverse = _integrate_dilations(geometry, shapes)
    sums, pressures = _integrate_shear(geometry, shapes, law.two_mu), law.dilation_modulus[:, None, None] * inverse
    on_edge, on_inside = (dilations.take(columns, axis=1) for columns in (places.edge, places.inner))
    push_edge, push_inside = pressures @ on_edge, pressures @ on_inside

    def build_block(chosen: Ints, moments: Floats, pushed: Floats) -> Floats:
        """Return one block: the shear part's chosen sums plus the products of moments and pressures.

        ``chosen`` are the places of the block's entries in the sums, ``moments`` the dilations of the block's rows for each
        pressure, and ``pushed`` the pressures that its columns cause.
        """
        whole = sums.take(chosen, axis=1)
        whole += moments.transpose(0, 2, 1) @ pushed
        return whole

    return Blocks(
        build_block(places.outside, on_edge, push_edge),
        build_block(places.across, on_inside, push_edge),
        build_block(places.inside, on_inside, push_inside),
    )


def _integrate_shear(geometry: Geometry, shapes: Shapes, two_mu: Floats) -> Floats:
    """Return the sums from which ``ElementTables.stiffness`` takes the integrals of 2 mu eps:eps, shape (n, sums).

    Derivatives by r and z are sums of derivatives X, Y by the unit square's x and y, such as xr X + yr Y by r. So each integral
    is a sum of products of functions, X and Y with coefficients at the Gauss points: those of X X, X Y and Y Y for u_r alone
    (``radial``), for u_z alone (``axial``), and for u_r with u_z.
    """
    table = shapes.tables
    (xr, xz), (yr, yz) = (geometry.inverse[..., k, :].transpose(2, 0, 1) for k in (0, 1))
    w = geometry.weight * two_mu[:, None]
    half = w / 2
    d_r = half * xr * xr, half * xr * yr, half * yr * yr  # of derivatives by r squared: X X, X Y and Y Y
    d_z = half * xz * xz, half * xz * yz, half * yz * yz
    # 2 mu (u_r,r^2 + u_r,z^2 / 2), and likewise for u_z
    radial, axial = ([2 * a + b for a, b in zip(*pair, strict=True)] for pair in ((d_r, d_z), (d_z, d_r)))
    sums = (
        table.symmetric([w / geometry.radius**2, *radial[:2], *radial[1:]]),
        table.symmetric([None, *axial[:2], *axial[1:]]),
        table.unsymmetric([half * xz * xr, half * xz * yr, half * yz * xr, half * yz * yr]),
    )
    return np.concatenate([array.reshape(len(w), array.shape[1] * array.shape[2]) for array in sums], axis=1)


def _integrate_dilations(geometry: Geometry, shapes: Shapes) -> tuple[Floats, Floats]:
    """Return sums for the integrals of m pressure functions times div u, and the inverse mass matrices of these functions.

    Shapes (n, sums) and (n, m, m); ``ElementTables.moments`` takes the integrals from the sums.
    """
    w, table, n = geometry.weight, shapes.tables, len(geometry.weight)
    by_r, by_z = ([w * geometry.inverse[..., k, axis] for k in (0, 1)] for axis in (0, 1))
    parts = [
        table.dilation([*derivatives, hoop]).reshape(n, -1) for derivatives, hoop in ((by_r, w / geometry.radius), (by_z, None))
    ]
    m = shapes.pressure.shape[1]
    return np.concatenate(parts, axis=1), np.asarray(np.linalg.inv((w @ shapes.mass).reshape(n, m, m)))


def compute_dilations(geometry: Geometry, shapes: Shapes, m: int = 0) -> Floats:
    """Return the matrices that give the projected dilation of fields of azimuthal order m, shape (n, pressures, 3, s).

    A field has the amplitudes U, V, W of its radial, azimuthal and axial displacement, which vary as cos or sin of m times the
    azimuth. The matrices act on the coefficients of U, V, W, with div u = U,r + (U + m V) / r + W,z, and give coefficients of the
    pressure functions. In nearly incompressible tissue the projection, not div u itself, enters the equilibrium.
    """
    (by_r, by_z), hoop = geometry.turn_derivatives(*shapes.derivative), shapes.value / geometry.radius[..., None]
    weighted = (geometry.weight[..., None] * shapes.pressure).transpose(0, 2, 1)
    moments = weighted @ np.concatenate([by_r + hoop, m * hoop, by_z], axis=2)
    coefficients = np.linalg.solve(weighted @ shapes.pressure, moments)
    return np.asarray(coefficients.reshape(*coefficients.shape[:2], 3, -1))


def project_dilations(geometry: Geometry, shapes: Shapes, dilation: Floats) -> Floats:
    """Project dilations of k fields at the Gauss points onto the pressure functions, and return them there; (n, q, k) both."""
    n, points, k = dilation.shape
    m = shapes.pressure.shape[1]
    # elements as rows of a few large products: many small ones take three times as long
    weighted = (geometry.weight[..., None] * dilation).transpose(0, 2, 1).reshape(n * k, points)
    moments = (weighted @ shapes.pressure).reshape(n, k, m).transpose(0, 2, 1)
    coefficients = np.linalg.solve((geometry.weight @ shapes.mass).reshape(n, m, m), moments)
    projected = coefficients.transpose(0, 2, 1).reshape(n * k, m) @ shapes.pressure.T
    return np.asarray(projected.reshape(n, k, points).transpose(0, 2, 1))
