"""The functions of a block's displacements, eqs. CF.8 and CF.9, and the integrals of their products, by tables.

Along the height all integrals are numbers of the decay times the height alone, times powers of the height; across a tube's wall
of the wall over the outer radius, times powers of the wall; a disc's are numbers. Each is computed once by quadrature, then
interpolated by polynomials with relative errors below 1e-10 (``tests/solver/closed_form/test_blocks.py``).

Of displacements w alone, products of modes are taken, sums of the P_i and of the f_j of which both the integrals of squares and
those of squares of derivatives are diagonal.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from geometry.common.arrays import Floats
from solver.closed_form.bessel import Array
from solver.closed_form.tractions import LOADS, Loads
from solver.linalg.piecewise import PiecewisePolynomials

RADIAL_FUNCTIONS = 3  # functions P_i
AXIAL_FUNCTIONS = 2  # functions g_j
HEIGHT_NODES = 10  # nodes of quadrature along the height, of fields
TABLE_HEIGHT_NODES = 48  # of the tables, tall blocks among them
WALL_NODES = 6  # across the wall
NODES_PER_RING = 4  # on each ring of a load
TABLE_DEGREE = 10  # degree of the tables' polynomials
DECAY_LOG_SCALE = 2.0  # decay times height: the table is linear in it below, logarithmic above
MAX_LOG_DECAY = 16.0  # of ln(1 + decay x height / LAYER): blocks ten million times as tall as wide
WALL_LOG_OFFSET = 1.01  # tubes' numbers are smooth in the logarithm of this less wall / radius


@dataclass(frozen=True)
class AxialFunctions:
    """The functions g_j and f_j of eqs. CF.8 and CF.9 at the nodes of quadrature along the heights of n blocks; blocks last.

    Attributes
    ----------
    zeta, weight
        Distances of the nodes from the tissue end, m, and weights of quadrature, m, shape (nodes, n).
    steep
        How much denser the nodes are near both ends, shape (n,).
    g, dg, f, df
        The functions, and their derivatives by zeta / h, shape (functions, nodes, n).
    """

    zeta: Array
    weight: Array
    steep: Array
    g: Array
    dg: Array
    f: Array
    df: Array

    def take(self, which: Any) -> AxialFunctions:
        """Return the functions of the blocks with indices ``which``."""
        return AxialFunctions(*(getattr(self, part.name)[..., which] for part in fields(self)))

    def interpolate(self, fraction: Array) -> tuple[Array, ...]:
        """Return g, dg, f and df at fractions (n, k) of the height, shapes (n, functions, k)."""
        steep = self.steep[:, None]
        # y: coordinate from -1 to 1 in which the functions are interpolated by polynomials
        y = np.arctanh((2 * fraction - 1) * np.tanh(steep)) / steep
        nodes = len(self.zeta)
        interpolation = (legendre.legvander(y, nodes - 1) @ _HEIGHT_RULES[nodes].series).swapaxes(1, 2)
        return tuple(values.transpose(2, 0, 1) @ interpolation for values in (self.g, self.dg, self.f, self.df))


def build_axial_functions(height: Array, steepness: Array, nodes: int = HEIGHT_NODES) -> AxialFunctions:
    """Build the functions g_j, and the f_j, of which there is one more, for n blocks.

    Parameters
    ----------
    height
        Heights h, m, shape (n,).
    steepness
        Decays times heights, b h of eq. CF.9, shape (n,).
    nodes
        Number of nodes along the height, one of those in ``_HEIGHT_RULES``.
    """
    rule = _HEIGHT_RULES[nodes]
    y, weight = rule.y[:, None], rule.weight[:, None]
    steep = 0.5 * np.log(1 + 0.5 * steepness) + 1e-3  # nodes as dense at both ends as the functions need
    tanh_node, tanh_end = np.tanh(steep * y), np.tanh(steep)
    fraction = (1 + tanh_node / tanh_end) / 2
    dz = (steep / (2 * tanh_end)) * (1 - tanh_node * tanh_node)
    # fractions count from the tissue end; top and fade are the two factors of eq. CF.9
    last = np.exp(-steepness)
    loss = 1 - last
    tissue_end_decay, base_end_decay = np.exp(-steepness * fraction), np.exp(steepness * (fraction - 1))
    top, fade = (1 - base_end_decay) / loss, (tissue_end_decay - last) / loss
    dtop, dfade = -steepness / loss * base_end_decay, -steepness / loss * tissue_end_decay
    powers = [1 + 0 * top, *accumulate([fade] * (AXIAL_FUNCTIONS - 1), np.multiply)]
    g = np.stack([top * power for power in powers])
    dg = np.stack([dtop * power for power in powers])
    for j in range(1, AXIAL_FUNCTIONS):
        dg[j] += j * top * powers[j - 1] * dfade
    df = np.stack([0 * fraction - 1, (last - base_end_decay) / loss, *g[1:]])  # -1, g_0 - 1 and the other g_j
    # every f_j is 0 at the base: minus the integral of its derivative from the node to there
    f = np.concatenate([(1 - fraction)[None], -(rule.remaining @ (df[1:] * dz))])
    return AxialFunctions(height * fraction, weight * (height * dz), steep, g, dg, f, df)


@dataclass(frozen=True)
class HeightRule:
    """Gauss's rule on (-1, 1).

    Attributes
    ----------
    y, weight
        Nodes and weights, shape (nodes,).
    series
        From values at the nodes to the coefficients of Legendre's polynomials, shape (nodes, nodes).
    remaining
        From these values to the integrals from each node to 1, shape (nodes, nodes).
    """

    y: Any
    weight: Any
    series: Any
    remaining: Any


def _build_height_rule(nodes: int) -> HeightRule:
    """Build Gauss's rule with the given number of nodes."""
    y, weight = legendre.leggauss(nodes)
    P, n = legendre.legvander(y, nodes), np.arange(1, nodes)
    series = (np.arange(nodes)[:, None] + 0.5) * P[:, :-1].T * weight
    ahead = np.column_stack([1 - y, (P[:, :-2] - P[:, 2:]) / (2 * n + 1)])  # Int_y^1 P_n
    return HeightRule(y, weight, series, ahead @ series)


_HEIGHT_RULES = {nodes: _build_height_rule(nodes) for nodes in (HEIGHT_NODES, TABLE_HEIGHT_NODES)}


@dataclass(frozen=True)
class AxialIntegrals:
    """Integrals along a block of height 1 of products of the functions (rows first); blocks last.

    Attributes
    ----------
    gg, dg_dg
        Of two functions g, and of the derivatives of two, shape (g_j, g_j, n).
    g_dmode, dg_mode
        Of g with the modes' derivatives, and of dg with the modes.
    derivative
        Of the squares of the modes' derivatives; of the modes' own they are one, shape (modes, n).
    end
        Modes at the tissue's end, shape (modes, n).
    modes
        How much of each f_j, the first among them, is in each mode, shape (f_j, modes, n).
    """

    gg: Array
    dg_dg: Array
    g_dmode: Array
    dg_mode: Array
    derivative: Array
    end: Array
    modes: Array


def interpolate_axial_integrals(steepness: Array) -> AxialIntegrals:
    """Interpolate the axial integrals for decays times heights (n,); NaN where blocks are far taller than wide."""
    return AxialIntegrals(*_build_axial_table()(np.log1p(steepness / DECAY_LOG_SCALE)))


@cache
def _build_axial_table() -> PiecewisePolynomials:
    """Build the table of the axial integrals, pieces of 0.25 in x = ln(1 + steepness / ``DECAY_LOG_SCALE``)."""
    return PiecewisePolynomials(
        lambda x: compute_axial_integrals(DECAY_LOG_SCALE * np.expm1(x)),
        0.0,
        0.25,
        int(MAX_LOG_DECAY / 0.25),
        TABLE_DEGREE,
    )


def compute_axial_integrals(steepness: Any) -> list[Any]:
    """Compute the fields of ``AxialIntegrals`` by quadrature, blocks along the first axis; ``steepness`` is b h, shape (n,)."""
    functions = build_axial_functions(np.ones_like(steepness), steepness, TABLE_HEIGHT_NODES)
    g, dg, f, df = functions.g, functions.dg, functions.f, functions.df

    def integrate_products(left: Any, right: Any) -> Any:
        """Return the integrals of products of functions (i, nodes, n) and (j, nodes, n), shape (n, i, j)."""
        return np.einsum("iqn,jqn,qn->nij", left, right, functions.weight)

    # f_j at the tissue end: minus the integral of its derivative, as f_j is 0 at the base
    f_end = -(functions.weight * df).sum(axis=1).T
    derivative, modes = _find_modes(integrate_products(f, f), integrate_products(df, df), f_end)
    of_modes = [integrate_products(left, right) @ modes for left, right in ((g, df), (dg, f))]
    return [integrate_products(g, g), integrate_products(dg, dg), *of_modes, derivative, (f_end[:, None] @ modes)[:, 0], modes]


def _find_modes(squares: Floats, derivatives: Floats, end: Floats) -> tuple[Any, Any]:
    """Find the modes: sums of functions that diagonalise the integrals of products and of products of derivatives.

    Parameters
    ----------
    squares, derivatives
        Integrals of the functions' products, and of their derivatives' products, shape (n, functions, functions).
    end
        The functions at the end where all modes are made positive, shape (n, functions).

    Returns
    -------
    tuple[Any, Any]
        Integrals of the squares of the modes' derivatives, shape (n, modes), and how much of each function (row) is in each mode
        (column), shape (n, functions, modes), such that the integrals of the modes' squares are 1.
    """
    low = np.linalg.inv(np.linalg.cholesky(squares))
    derivative, turn = np.linalg.eigh(low @ derivatives @ low.swapaxes(1, 2))
    modes = low.swapaxes(1, 2) @ turn
    return derivative, modes * np.sign(end[:, None] @ modes)


@dataclass(frozen=True)
class RadialIntegrals:
    """Integrals over the end of a block of width 1, divided by its outer radius; rows first, blocks last.

    Of a tube the U_i begin with a constant, which is the outer radius, and whose volume does not change.

    Attributes
    ----------
    strain
        Twice (e_rr e_rr + e_hoop e_hoop) of two u.
    slide
        u u, shape (U_i, U_i, n).
    widened, turned
        d(r u)/dr / r with the modes, and u with their derivatives, shapes (U_i, modes, n).
    derivative
        Of the squares of the modes' derivatives; of the modes' own they are one, shape (modes, n).
    pressed, sheared
        Loads on the modes and on the u, the shears' functions meant times r / radius, shapes (loads, ., n).
    modes
        How much of each P_i is in each mode, shape (P_i, modes, n).
    """

    strain: Array
    slide: Array
    widened: Array
    turned: Array
    derivative: Array
    pressed: Array
    sheared: Array
    modes: Array


def interpolate_radial_integrals(wall: Array | None) -> RadialIntegrals:
    """Interpolate the radial integrals of tubes for walls over outer radii (n,); of a disc where ``wall`` is None, then n = 1."""
    return _compute_disc_integrals() if wall is None else RadialIntegrals(*_build_wall_table()(np.log(WALL_LOG_OFFSET - wall)))


@cache
def _compute_disc_integrals() -> RadialIntegrals:
    """Compute the integrals of a disc, which are the same for all: n = 1."""
    return RadialIntegrals(*(np.moveaxis(part, 0, -1) for part in compute_radial_integrals(np.ones(1), True)))


@cache
def _build_wall_table() -> PiecewisePolynomials:
    """Build the table of a tube's integrals, ten pieces in x = ln(``WALL_LOG_OFFSET`` - wall / outer radius)."""
    start = np.log(WALL_LOG_OFFSET - 1)
    return PiecewisePolynomials(
        lambda x: compute_radial_integrals(WALL_LOG_OFFSET - np.exp(x), False),
        start,
        (np.log(WALL_LOG_OFFSET) - start) / 10,
        10,
        TABLE_DEGREE,
    )


def compute_radial_integrals(wall: Any, solid: bool) -> list[Any]:
    """Compute the fields of ``RadialIntegrals`` by quadrature, blocks along the first axis.

    ``wall`` is the wall over the outer radius, shape (n,), and 1 for discs (``solid``).
    """
    hole = 1 / wall - 1  # inner radius over width
    y, weight = _build_gauss_rule((0.0, 1.0), WALL_NODES)
    P, derivative, r, u = _evaluate_functions(y, hole, solid)
    ring = 2 * np.pi * wall[:, None] * r * weight
    hoop = u / r[:, None]
    volume = np.concatenate([P[:, :0] if solid else 0 * P[:, :1], P], axis=1)  # d(r u)/dr / r

    def integrate_products(left: Any, right: Any) -> Any:
        """Return the integrals of products of functions (n, i, points) and (n, j, points), shape (n, i, j)."""
        return (left * ring[:, None]) @ right.swapaxes(1, 2)

    squares, derivatives = integrate_products(P, P), integrate_products(derivative, derivative)
    derivative_squares, modes = _find_modes(squares, derivatives, np.ones((1, RADIAL_FUNCTIONS)))
    rr = volume - hoop
    strain = 2 * (integrate_products(rr, rr) + integrate_products(hoop, hoop))
    pressed, sheared = _integrate_loads(hole, wall, LOADS.loads[0 if solid else 1])
    of_modes = [integrate_products(left, right) @ modes for left, right in ((volume, P), (u, derivative))]
    return [strain, integrate_products(u, u), *of_modes, derivative_squares, pressed @ modes, sheared, modes]


def _integrate_loads(hole: Floats, wall: Floats, loads: Loads) -> tuple[Any, Any]:
    """Return the work of the pressures on the P_i and of the shears on the u, shapes (m, loads, functions).

    ``hole`` is the inner radius over the width, ``wall`` the width over the outer radius, shape (m,) both.
    """
    y, weight = _build_gauss_rule(tuple(loads.cuts), NODES_PER_RING)
    P, _, r, u = _evaluate_functions(y, hole, loads.solid)
    ring = 2 * np.pi * wall[:, None] * r * weight
    pressure, shear = (np.repeat(values, NODES_PER_RING, axis=0).T for values in (loads.pressure, loads.shear))
    return (pressure * ring[:, None]) @ P.swapaxes(1, 2), (shear * (ring * r * wall[:, None])[:, None]) @ u.swapaxes(1, 2)


def _build_gauss_rule(cuts: tuple[float, ...], points: int) -> tuple[Any, Any]:
    """Return Gauss's nodes and weights with ``points`` nodes in each interval between increasing numbers ``cuts``."""
    x, weight = legendre.leggauss(points)
    parts, low = np.diff(cuts)[:, None], np.array(cuts)[:-1, None]
    return (low + parts * (x + 1) / 2).ravel(), (parts * weight / 2).ravel()


def _evaluate_functions(y: Floats, hole: Floats, solid: bool) -> tuple[Any, Any, Any, Any]:
    """Return P_i, dP_i/dr, r and u = U_i / r of m blocks of width 1, shapes (m, functions, points), of r (m, points).

    ``y`` are fractions of the width, shape (points,), ``hole`` the inner radii, shape (m,), 0 for discs (``solid``).
    """
    # six nodes between 0 and each y integrate U_i exactly
    x, weight = legendre.leggauss(6)
    x, weight = (x + 1) / 2, weight / 2
    polynomials = [legendre.Legendre(row, domain=[0, 1]) for row in np.eye(RADIAL_FUNCTIONS)]
    inside = np.multiply.outer(y, x)
    values = np.array([p(inside**2 if solid else inside) for p in polynomials]) * weight
    argument, scale = (y**2, 2 * y) if solid else (y, 1 + 0 * y)
    P, derivative = np.array([p(argument) for p in polynomials]), np.array([p.deriv()(argument) * scale for p in polynomials])
    r, hole = hole[:, None] + y, hole[:, None, None]
    u = y * (hole * values.sum(axis=2) + (values * inside).sum(axis=2)) / r[:, None]  # Int_0^y P r dy
    if not solid:
        u = np.concatenate([(hole + 1) / r[:, None], u], axis=1)
    repeated = np.broadcast_to(P, (len(r), *P.shape)), np.broadcast_to(derivative, (len(r), *derivative.shape))
    return *repeated, r, u
