"""Compute element matrices of rectangles r_0 < r < r_0 + h of height l, from products of shared one-dimensional integrals.

M and M_1 are the integrals of N_i N_j and x N_i N_j of the functions N over the unit interval, S and S_1 those of their
derivatives, C and C_1 those of N_i with the derivative of N_j. Points x_a with weights w_a have the radii r_a. In products,
factors along r come before those along z. Per unit 2 mu and 2 pi, the blocks of u_r and u_z are:

    K_rr = l / h (r_0 S + h S_1) M + h / l (r_0 M + h M_1) S / 2 + h l sum_a w_a / r_a N_i(x_a) N_j(x_a) M
    K_zz = h / l (r_0 M + h M_1) S + l / h (r_0 S + h S_1) M / 2                                              (EL.2)
    K_rz = (r_0 C + h C_1) C^T / 2

The part by lambda depends on r_0 and h only, apart from factors l, 1 and 1 / l of its blocks r r, r z and z z: rectangles between
the same two radii share it. The result equals that of ``quadrilateral``, to rounding, in a third of the time.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg.blas import dger

from geometry.common.arrays import Floats, Ints
from solver.elements.quadrilateral import Blocks, Geometry, integrate_volumetric
from solver.elements.shape_functions import Shapes, build_shapes, evaluate_edge_functions, evaluate_legendre
from solver.linalg.workspace import keep_table
from solver.materials.linear import Isotropic


@dataclass(frozen=True)
class RectangleTables:
    """Integrals of eq. EL.2 for pairs of functions.

    Attributes
    ----------
    rr
        Factors of l r_0 / h, l, h r_0 / l, h^2 / l and h l / r_a, for pairs on corners and edges, of the inside with these, and
        within; shape (4 + points, pairs).
    zz
        Factors of the first four of these, for the same pairs, shape (4, pairs).
    rz
        Factors of r_0 and h, for all pairs, shape (2, s^2).
    pairs
        The numbers of the pairs' functions, shape (2, pairs).
    """

    rr: Floats
    zz: Floats
    rz: Floats
    pairs: Ints


@keep_table
def _build_tables(order: int) -> RectangleTables:
    """Tabulate the integrals of eq. EL.2 for one order; symbols as in the module."""
    shapes = build_shapes(order)
    # s functions, the first m on corners and edges; Gauss points along each axis, x with weights w
    s, m, points = len(shapes.degrees), shapes.skeleton, shapes.order + 2
    x, w = shapes.points.reshape(points, points, 2)[:, 0, 0], shapes.weights.reshape(points, points).sum(axis=1)
    N, S = evaluate_edge_functions(x, evaluate_legendre(x, shapes.order))
    edge, inner = np.arange(m), np.arange(m, s)
    groups = [
        np.stack(np.meshgrid(*pair, indexing="ij")).reshape(2, -1) for pair in ((edge, edge), (inner, edge), (inner, inner))
    ]
    pairs, all_pairs = np.hstack(groups), np.indices((s, s)).reshape(2, -1)
    values, derivatives = (np.einsum("a,ai,aj->aij", w, factor, factor) for factor in (N, S))
    # N with its derivatives: crossed is N_i S_j, from which C follows
    crossed = np.einsum("a,ai,aj->aij", w, N, S)
    M, C = values.sum(axis=0), crossed.sum(axis=0)

    def integrate_moments(products: Floats) -> Floats:
        """Return integrals over the unit interval of products and of x times products, shape (2, p + 1, p + 1)."""
        return np.stack([products.sum(axis=0), np.einsum("a,aij->ij", x, products)])

    def tabulate(by_x: Floats, by_y: Floats, chosen: Ints) -> Floats:
        """Return products of integrals along x, (k, p + 1, p + 1), and y, (p + 1, p + 1), for ``chosen`` pairs of functions.

        The functions are two-dimensional, and the result has shape (k, pairs).
        """
        (x_one, y_one), (x_other, y_other) = (shapes.degrees[index].T for index in chosen)
        return np.asarray(by_x[:, x_one, x_other] * by_y[y_one, y_other])

    stretched, sheared = (
        tabulate(integrate_moments(derivatives), M, pairs),
        tabulate(integrate_moments(values), derivatives.sum(axis=0), pairs),
    )
    rr = np.concatenate([stretched, sheared / 2, tabulate(values, M, pairs)])
    return RectangleTables(
        rr, np.concatenate([stretched / 2, sheared]), tabulate(integrate_moments(crossed), C.T, all_pairs) / 2, pairs
    )


def integrate_rectangles(geometry: Geometry, shapes: Shapes, law: Isotropic, columns: Ints) -> Blocks:
    """Return the blocks of rectangles' stiffness matrices, as ``quadrilateral.integrate_stiffness`` does in general.

    Parameters
    ----------
    geometry
        Geometry of the n rectangles.
    shapes
        Shape functions.
    law
        Moduli of each rectangle, shape (n,).
    columns
        Number of the first rectangle of each run between the same two radii, and n at the end; rising.
    """
    table, s, (first, count) = _build_tables(shapes.order), len(shapes.degrees), (columns[:-1], np.diff(columns))
    rr, zz, rz = _integrate_shear(geometry, shapes, law.two_mu)
    volume, (i, j), high = integrate_volumetric(geometry.select(first), shapes), table.pairs, 1 / geometry.inverse[:, 0, 1, 1]
    # the part by lambda is that of each run's first rectangle times a power of the ratio of heights, ``tall``
    tall, lam = high / np.repeat(high[first], count), law.dilation_modulus
    _add_products(rr, lam * tall, volume[:, 0, :, 0][:, i, j], columns)
    _add_products(zz, lam / tall, volume[:, 1, :, 1][:, i, j], columns)
    _add_products(rz, lam, volume[:, 0, :, 1].reshape(len(first), s * s), columns)
    return _build_blocks(rr, zz, rz.reshape(-1, s, s), shapes.skeleton)


def _integrate_shear(geometry: Geometry, shapes: Shapes, two_mu: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the parts r r, z z and r z of eq. EL.2, times 2 mu and 2 pi, for the pairs of ``RectangleTables``.

    Rectangles are ``wide`` (h) along r and ``high`` (l) along z. Shapes (n, pairs), twice, and (n, s^2).
    """
    table, wide, high = _build_tables(shapes.order), 1 / geometry.inverse[:, 0, 0, 0], 1 / geometry.inverse[:, 0, 1, 1]
    radii = geometry.radius[:, :: shapes.order + 2]
    # inner is r_0: the first Gauss point's radius minus its distance from the inner side
    inner, factor = radii[:, 0] - shapes.points[0, 0] * wide, 2 * np.pi * two_mu
    flat, steep = factor * wide / high, factor * high / wide
    four = np.column_stack([steep * inner, steep * wide, flat * inner, flat * wide])
    rr = np.hstack([four, (factor * wide * high)[:, None] / radii]) @ table.rr
    return rr, four @ table.zz, np.column_stack([factor * inner, factor * wide]) @ table.rz


def _add_products(sums: Floats, factors: Floats, parts: Floats, columns: Ints) -> None:
    """Add to each rectangle's sums, in place, its factor times a part that its column of rectangles has in common.

    Parameters
    ----------
    sums
        Shape (n, pairs).
    factors
        Factor of each rectangle, shape (n,).
    parts
        Part of each column of rectangles between the same two radii, shape (columns, pairs).
    columns
        Number of the first rectangle of each column, and n at the end.
    """
    for part, (start, end) in zip(parts, pairwise(columns), strict=True):
        dger(1.0, part, factors[start:end], a=sums[start:end].T, overwrite_a=1)


def _build_blocks(rr: Floats, zz: Floats, rz: Floats, m: int) -> Blocks:
    """Assemble the blocks from the parts r r, z z and r z, u_r before u_z; the first ``m`` functions are on corners and edges.

    Parts r r and z z have shape (n, pairs), in the order of ``RectangleTables.pairs``, and r z (n, s, s).
    """
    n, parts, start, (edge, inner) = len(rz), [], 0, (slice(None, m), slice(m, None))
    for rows, cols in ((edge, edge), (inner, edge), (inner, inner)):
        across = rz[:, rows, cols]
        a, b = across.shape[1:]
        out, columns = np.empty((n, 2, a, 2, b)), slice(start, start := start + a * b)
        out[:, 0, :, 0], out[:, 1, :, 1] = (array[:, columns].reshape(n, a, b) for array in (rr, zz))
        out[:, 0, :, 1], out[:, 1, :, 0] = across, rz[:, cols, rows].transpose(0, 2, 1)
        parts.append(out.reshape(n, 2 * a, 2 * b))
    return Blocks(*parts)
