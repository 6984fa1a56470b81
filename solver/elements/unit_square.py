"""Sum over Gauss points in the coordinates x, y of the unit square, where all elements share their functions.

Stresses, which work on derivatives by r and z and on u / r, are first transformed point by point to work on X, Y and N, the
derivatives by x and y and the value. What remains is one large matrix product with tables of the functions, or of their products,
for all elements. Components of a gradient of u_r, u_z are ordered rr, rz, zr, zz, tt, first axis; transformed ones rX, rY, zX,
zY, N.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from solver.elements.quadrilateral import Geometry
from solver.elements.shape_functions import Shapes, build_shapes
from solver.linalg.workspace import keep_table


@dataclass(frozen=True)
class Tables:
    """Functions N and their derivatives X, Y at the q Gauss points, and their products with each other and with pressures P.

    Attributes
    ----------
    flat
        X, Y, N, shape (s, 3 q).
    radial
        X X, X Y + Y X, Y Y, X N + N X, Y N + N Y, N N, shape (6 q, s^2).
    crossed
        X X, X Y, Y X, Y Y, N X, N Y, shape (6 q, s^2).
    vertical
        X X, X Y + Y X, Y Y, shape (3 q, s^2).
    pressed
        P X, P Y, P N, shape (3 q, m s).
    """

    flat: Floats
    radial: Floats
    crossed: Floats
    vertical: Floats
    pressed: Floats


@dataclass(frozen=True)
class UnitSquare:
    """The geometry of elements with the map from the unit square.

    Attributes
    ----------
    functions
        Shape functions of the elements.
    tables
        Tables of these functions.
    weight
        2 pi r dA at the Gauss points, shape (n, q).
    xr, xz, yr, yz
        Derivatives dx/dr, dx/dz, dy/dr and dy/dz, shape (n, q) each.
    inverse_radius
        1 / r, shape (n, q).
    """

    functions: Shapes
    tables: Tables
    weight: Floats
    xr: Floats
    xz: Floats
    yr: Floats
    yz: Floats
    inverse_radius: Floats

    @classmethod
    def from_geometry(cls, geometry: Geometry, functions: Shapes) -> UnitSquare:
        """Build from the geometry of elements at their Gauss points, and their functions."""
        xr, xz, yr, yz = (np.ascontiguousarray(geometry.inverse[..., k, c]) for k in (0, 1) for c in (0, 1))
        return cls(functions, _build_tables(functions.order), geometry.weight, xr, xz, yr, yz, 1 / geometry.radius)

    def compute_gradients(self, u: Floats) -> Floats:
        """Return the displacement gradients rr, rz, zr, zz, tt at the Gauss points, shape (5, n, q).

        ``u`` are the coefficients of the functions, u_r before u_z, shape (n, 2 s).
        """
        n, q = self.weight.shape
        x, y, value = (u.reshape(2 * n, -1) @ self.tables.flat).reshape(n, 2, 3, q).transpose(2, 1, 0, 3)
        out = np.empty((5, n, q))
        for c in (0, 1):
            out[2 * c] = self.xr * x[c] + self.yr * y[c]
            out[2 * c + 1] = self.xz * x[c] + self.yz * y[c]
        out[4] = self.inverse_radius * value[0]
        return out

    def turn_stress(self, stress: Floats) -> Floats:
        """Transform stresses that work on displacement gradients to those that work on rX, rY, zX, zY and N; (5, n, q) both."""
        out = np.empty_like(stress)
        for c in (0, 2):
            out[c] = self.xr * stress[c] + self.xz * stress[c + 1]
            out[c + 1] = self.yr * stress[c] + self.yz * stress[c + 1]
        out[4] = self.inverse_radius * stress[4]
        return out

    def turn_unit_matrix(self) -> Floats:
        """Transform the unit matrix: return its entries rX rX (= zX zX), rX rY (= zX zY), rY rY (= zY zY), N N, (4, n, q)."""
        xr, xz, yr, yz = self.xr, self.xz, self.yr, self.yz
        return np.stack([xr**2 + xz**2, xr * yr + xz * yz, yr**2 + yz**2, self.inverse_radius**2])

    def sum_forces(self, turned: Floats) -> Floats:
        """Sum transformed stresses, (5, n, q), multiplied by the weights before, to forces on the coefficients, (n, 2 s)."""
        n, q, s = *self.weight.shape, len(self.functions.degrees)
        out = np.empty((n, 2, s))
        out[:, 0] = _join_parts(turned[[0, 1, 4]]) @ self.tables.flat.T
        out[:, 1] = _join_parts(turned[2:4]) @ self.tables.flat[:, : 2 * q].T
        return out.reshape(n, -1)

    def sum_moments(self, turned: Floats) -> Floats:
        """Sum the products of transformed stresses, (5, n, q), weights included, and each of m pressures; shape (n, m, 2 s)."""
        n, q, s = *self.weight.shape, len(self.functions.degrees)
        out = np.empty((n, self.functions.pressure.shape[1], 2, s))
        out[:, :, 0] = (_join_parts(turned[[0, 1, 4]]) @ self.tables.pressed).reshape(n, -1, s)
        out[:, :, 1] = (_join_parts(turned[2:4]) @ self.tables.pressed[: 2 * q]).reshape(n, -1, s)
        return out.reshape(n, -1, 2 * s)

    def sum_stiffness(self, turned: Floats) -> Floats:
        """Sum a symmetric matrix of transformed components, weights included, (5, 5, n, q), to stiffness, (n, 2 s, 2 s).

        Of its entries the upper triangle and those of rX, rY and N with zX, zY are used.
        """
        D, n, s = turned, len(self.weight), len(self.functions.degrees)
        out = np.empty((n, 2, s, 2, s))
        radial = np.stack([D[0, 0], D[0, 1], D[1, 1], D[0, 4], D[1, 4], D[4, 4]])
        crossed = np.stack([D[0, 2], D[0, 3], D[1, 2], D[1, 3], D[4, 2], D[4, 3]])
        out[:, 0, :, 0] = (_join_parts(radial) @ self.tables.radial).reshape(n, s, s)
        out[:, 1, :, 1] = (_join_parts(np.stack([D[2, 2], D[2, 3], D[3, 3]])) @ self.tables.vertical).reshape(n, s, s)
        out[:, 0, :, 1] = (_join_parts(crossed) @ self.tables.crossed).reshape(n, s, s)
        out[:, 1, :, 0] = out[:, 0, :, 1].transpose(0, 2, 1)
        return out.reshape(n, 2 * s, 2 * s)


def _join_parts(parts: Floats) -> Floats:
    """Rearrange k components of n elements at q points, (k, n, q), to one row for each element, (n, k q)."""
    return np.ascontiguousarray(parts.transpose(1, 0, 2)).reshape(parts.shape[1], -1)


@keep_table
def _build_tables(order: int) -> Tables:
    """Tabulate the functions of one order and their products at the Gauss points."""
    functions = build_shapes(order)
    x, y, value = *functions.derivative, functions.value

    def multiply(*pairs: tuple[Floats, Floats]) -> Floats:
        """Return products of all functions of each pair of tables, one pair below the other."""
        return np.concatenate([(a[:, :, None] * b[:, None]).reshape(len(a), -1) for a, b in pairs])

    def symmetrise(a: Floats, b: Floats) -> Floats:
        """Return the sum of the products a b and b a of two tables: the symmetric part of a matrix's table, times two."""
        return multiply((a, b)) + multiply((b, a))

    vertical = np.concatenate([multiply((x, x)), symmetrise(x, y), multiply((y, y))])
    radial = np.concatenate([vertical, symmetrise(x, value), symmetrise(y, value), multiply((value, value))])
    crossed = multiply((x, x), (x, y), (y, x), (y, y), (value, x), (value, y))
    pressed = multiply(*((functions.pressure, factor) for factor in (x, y, value)))
    return Tables(np.concatenate([x, y, value]).T.copy(), radial, crossed, vertical, pressed)
