"""How a block gives way at its tissue end, held by the base at the other: Ritz's method with few functions.

A block is a disc, y = r / radius, or a tube, y = (r - hole) / wall, of height h; zeta runs from its tissue end (0) to the base
(h). Displacements, w towards the tissue and u outwards, are products

    w = sum W_ij P_i f_j(zeta),     u = (1/r) sum a_ij U_i g_j(zeta)                              (CF.8)

with Legendre's polynomials P_i on (0, 1), of y^2 in a disc, of y in a tube, and U_i = Int P_i r dr, in a tube a constant too.
The trace of the strain is d(r u)/dr / r - dw/dzeta; every dU/dr / r g is also a dw/dzeta, as f_0 = 1 - zeta/h and
f_j = Int_zeta^h g. So volume can be kept wherever shape changes and nothing locks as nu nears 1/2. With v = 1 - zeta/h and a
decay b of the block's width,

    g_j = (1 - exp(-b h v)) / (1 - exp(-b h)) ((exp(-b zeta) - exp(-b h)) / (1 - exp(-b h)))^j      (CF.9)

which are v, v^2, v^3 in a flat block and, in a tall one, a column clamped at the base with what decays from its loaded end.
The stiffness K of these functions and the work B of tractions on them give the compliance B K^-1 B^T of the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from solver.closed_form.bessel import Array
from solver.closed_form.block_functions import AXIAL, FINE_AXIAL, Along, along_height
from solver.closed_form.tractions import Loads, batched_matmul

RADIAL, FINE_RADIAL = 3, 5  # functions P_i
POINTS, FINE_POINTS = 6, 10  # of quadrature across the wall


def _polynomials() -> Any:
    P = [legendre.Legendre(row, domain=[0, 1]) for row in np.eye(RADIAL)]
    return P, [p.deriv() for p in P], [p.integ(lbnd=0) for p in P]


_POLYNOMIALS = _polynomials()


@dataclass(frozen=True)
class ElasticBlocks:
    """Blocks, all solid (``hole`` None) or all tubes: radii, height, modulus, Poisson's ratio; arrays of shape (n,), SI.

    ``fine`` asks for more functions, in the block and under it.
    """

    hole: Array | None
    radius: Array
    height: Array
    E: Array
    nu: Array
    fine: bool = False

    @property
    def radial(self) -> int:
        """How many functions P_i it has."""
        return FINE_RADIAL if self.fine else RADIAL

    @property
    def start(self) -> Array:
        """Inner radius, m."""
        return 0 * self.radius if self.hole is None else self.hole

    @property
    def width(self) -> Array:
        """Radius of a disc, wall of a tube, m."""
        return self.radius - self.start

    @property
    def area(self) -> Array:
        """Area of the end, m^2."""
        return np.pi * self.width * (self.radius + self.start)

    def radii(self, y: Any) -> Array:
        """Radii at shares y (k,) of the width, shape (n, k)."""
        return self.start[:, None] + self.width[:, None] * np.asarray(y)


def end_compliance(block: ElasticBlocks, loads: Loads, bonded: bool) -> tuple[Array, Array, Array]:
    """Work of the end's displacements under unit loads on each other: of pressures, shears, pressures (rows) and shears.

    The shears' functions are meant times r / radius. Shapes (n, p, p), (n, s, s), (n, p, s); m^3/N times m^2.
    """
    along = along_height(block.height, _decay(block), FINE_AXIAL if block.fine else AXIAL)
    K = _stiffness(block, _softened(block, bonded), _across(block), along)
    w, u = _on_rings(block, loads)
    n, p, s = len(w), w.shape[1], u.shape[1]
    size, end = block.radial * len(along.end), np.moveaxis(along.end, 1, 0)[:, None, None]
    B = np.zeros((n, p + s, K.shape[1]), dtype=K.dtype)
    B[:, :p, :size] = (w[:, :, :, None] * end).reshape(n, p, -1)
    B[:, p:, size:] = np.repeat(u, len(along.end) - 1, axis=2)  # every g_j is 1 at the tissue's end
    work = B @ np.linalg.solve(K, np.swapaxes(B, 1, 2))
    return work[:, :p, :p], work[:, p:, p:], work[:, :p, p:]


def radial(radius: Array, r: Array) -> tuple[Array, Array, Array]:
    """P_i, dP_i/dr and U_i / r of discs at distances r (n, k) > 0 from the axis, shapes (n, functions, k)."""
    s = (r / radius[:, None]) ** 2
    P, slope, U = (np.stack([p(s) for p in kind], axis=1) for kind in _POLYNOMIALS)
    return P, slope * (2 * s / r)[:, None], U * (r / (2 * s))[:, None]


def column(block: ElasticBlocks) -> tuple[Array, Along]:
    """Return the stiffness K of a block's functions, and these along its height."""
    along = along_height(block.height, _decay(block), AXIAL)
    return _stiffness(block, block.E, _across(block), along), along


@dataclass(frozen=True)
class _Radial:
    """P_i at some y, dP_i/dy, and Int_0^y P_i dy, Int_0^y P_i y dy; rows i."""

    P: Any
    slope: Any
    plain: Any
    moment: Any


@lru_cache(maxsize=8)
def _table(solid: bool, radial: int, cuts: tuple[float, ...], points: int) -> tuple[Any, Any, _Radial]:
    """Gauss's nodes and weights between the cuts, with so many functions there."""
    x, weight = legendre.leggauss(points)
    parts, low = np.diff(cuts)[:, None], np.array(cuts)[:-1, None]
    y = (low + parts * (x + 1) / 2).ravel()
    return y, (parts * weight / 2).ravel(), _radial(solid, radial, y)


def _radial(solid: bool, radial: int, y: Any) -> _Radial:
    x, weight = legendre.leggauss(6)
    x, weight = (x + 1) / 2, weight / 2
    polynomials = [legendre.Legendre(np.eye(radial)[i], domain=[0, 1]) for i in range(radial)]
    at, scale = (y**2, 2 * y) if solid else (y, 1 + 0 * y)
    inside = np.multiply.outer(y, x)
    values = np.array([p(inside**2 if solid else inside) for p in polynomials])
    return _Radial(
        np.array([p(at) for p in polynomials]),
        np.array([p.deriv()(at) * scale for p in polynomials]),
        (values @ weight) * y,
        ((values * inside) @ weight) * y,
    )


def _fluxes(block: ElasticBlocks, table: _Radial) -> Array:
    """The U_i, m^2: Int P_i r dr from the hole on, and for a tube a constant first; shape (n, functions, len(y))."""
    width, start = block.width[:, None, None], block.start[:, None, None]
    U = width * (start * table.plain + width * table.moment)
    return U if block.hole is None else np.concatenate([0 * U[:, :1] + (block.radius**2)[:, None, None], U], axis=1)


def _on_rings(block: ElasticBlocks, loads: Loads) -> tuple[Array, Array]:
    """Work of the pressures on the P_i and of the shears on the U_i / r, shapes (n, loads, functions).

    All are polynomials of start and width times numbers, 2 pi width Int (start + width y) .. dy over the rings.
    """
    y, weight, table = _table(block.hole is None, block.radial, tuple(loads.cuts), 4)
    rings = np.repeat(np.eye(len(loads.cuts) - 1), 4, axis=0) * weight[:, None]
    pressed, sheared = (rings @ values for values in (loads.pressure, loads.shear))
    start, width = block.start, block.width
    ring = 2 * np.pi * width
    w = _sum_of(((ring * start, table.P), (ring * width, y * table.P)), pressed)
    over = ring * width / block.radius
    parts = (
        (over * start * start, table.plain),
        (over * start * width, y * table.plain + table.moment),
        (over * width * width, y * table.moment),
    )
    u = _sum_of(parts, sheared)
    if block.hole is not None:
        one = 1 + 0 * y[None]
        u = np.concatenate(
            [_sum_of(((ring * start * block.radius, one), (ring * width * block.radius, y * one)), sheared), u], axis=2
        )
    return w, u


def _sum_of(parts: Sequence[tuple[Array, Any]], loads: Any) -> Array:
    """Sum of factors (n,) times integrals of functions (functions, points) under loads (points, loads); (n, loads, functions)."""
    factors = np.stack([factor for factor, _ in parts], axis=1)
    numbers = np.stack([(functions @ loads).T for _, functions in parts])
    return (factors @ numbers.reshape(len(parts), -1)).reshape(len(factors), *numbers.shape[1:])


@dataclass(frozen=True)
class _Across:
    """Integrals over the end's area of products of the radial functions; blocks last."""

    strain: Array  # e_rr e_rr + e_hoop e_hoop of two u
    spread: Array  # (e_rr + e_hoop) of two u
    slide: Array  # u u
    mixed: Array  # (e_rr + e_hoop) of u, w
    turn: Array  # u dw/dr
    tilt: Array  # dw/dr dw/dr
    lift: Array  # w w


def _across(block: ElasticBlocks) -> _Across:
    """A disc's are numbers times powers of its radius."""
    if block.hole is not None:
        return _across_tubes(block)
    one, square = np.ones(1), block.radius * block.radius
    unit = _across_tubes(ElasticBlocks(None, one, one, one, one, block.fine))
    return _Across(
        unit.strain * square,
        unit.spread * square,
        slide=unit.slide * (square * square),
        mixed=unit.mixed * square,
        turn=unit.turn * square,
        tilt=unit.tilt + 0 * square,
        lift=unit.lift * square,
    )


def _across_tubes(block: ElasticBlocks) -> _Across:
    y, weight, table = _table(block.hole is None, block.radial, (0.0, 1.0), FINE_POINTS if block.fine else POINTS)
    r = block.radii(y)[:, None, :]
    U = _fluxes(block, table)
    both = table.P if block.hole is None else np.concatenate([0 * table.P[:1], table.P])
    u = U / r
    hoop = u / r
    width = block.width
    ring = 2 * np.pi * width[:, None, None] * weight * r
    rr = both - hoop
    strain = (rr * ring) @ np.swapaxes(rr, 1, 2) + (hoop * ring) @ np.swapaxes(hoop, 1, 2)
    inner, outer = 2 * np.pi * block.start, 2 * np.pi * width
    plain, moment = (table.P * (weight * part) @ table.P.T for part in (1.0, y))
    lift = width * (plain[:, :, None] * inner + moment[:, :, None] * outer)
    plain, moment = (table.slope * (weight * part) @ table.slope.T for part in (1.0, y))
    tilt = (plain[:, :, None] * inner + moment[:, :, None] * outer) / width
    spread = mixed = lift
    if block.hole is not None:  # the constant U has no e_rr + e_hoop
        mixed = np.concatenate([0 * lift[:1], lift])
        spread = np.concatenate([0 * mixed[:, :1], mixed], axis=1)
    turn = batched_matmul(U, 2 * np.pi * weight[:, None] * table.slope.T)
    return _Across(
        np.moveaxis(strain, 0, 2),
        spread,
        slide=np.moveaxis((u * ring) @ np.swapaxes(u, 1, 2), 0, 2),
        mixed=mixed,
        turn=np.moveaxis(turn, 0, 2),
        tilt=tilt,
        lift=lift,
    )


def _decay(block: ElasticBlocks) -> Array:
    """The decay b of eq. CF.9, 1/m."""
    return (2.2 if block.hole is None else 2.0) / block.width


# by which share the functions are too stiff, with w the width:
# (2 nu)^power / (tall h/w (w/radius)^(3/2) + constant + flat w/h) (CF.10)
_STIFF = {
    (True, True): (4.05, 3.97, 4.51, 5.92),
    (True, False): (8.24, 8.17, 1.89, 4.89),
    (False, True): (1.65, 8.19, 1.58, 7.06),
    (False, False): (8.72, 4.27, 4.68, 3.50),
}  # solid or tube; bonded or frictionless


def _softened(block: ElasticBlocks, bonded: bool) -> Array:
    """E without what the few functions are too stiff by, as they leave out the corners' singularities: eq. CF.10.

    Fitted to finite elements of 300 blocks on stiff ground by ``benchmarks/closed_form/blocks.py``; what is left is
    below 1.5 % of a disc, 6 % of a tube. More functions are taken as they are.
    """
    if block.fine:
        return block.E
    tall, constant, flat, power = _STIFF[block.hole is None, bonded]
    slender, thin = block.height / block.width, block.width / block.radius
    return block.E / (1 + (2 * block.nu) ** power / (tall * slender * thin**1.5 + constant + flat / slender))


def _stiffness(block: ElasticBlocks, E: Array, wall: _Across, along: Along) -> Array:
    """K of eq. CF.8's functions, W first."""
    mu = E / (2 * (1 + block.nu))
    lam = 2 * mu * (block.nu / (1 - 2 * block.nu))
    ww = _kron((lam + 2 * mu) * wall.lift, along.df_df) + _kron(mu * wall.tilt, along.ff)
    uu = _kron(lam * wall.spread + 2 * mu * wall.strain, along.gg) + _kron(mu * wall.slide, along.dg_dg)
    uw = -_kron(lam * wall.mixed, along.g_df) - _kron(mu * wall.turn, along.dg_f)
    size = len(ww)
    K = np.empty((size + len(uu), size + len(uu), len(mu)), dtype=uw.dtype)
    K[:size, :size], K[size:, size:], K[size:, :size], K[:size, size:] = ww, uu, uw, np.swapaxes(uw, 0, 1)
    return np.ascontiguousarray(np.moveaxis(K, 2, 0))


def _kron(a: Array, b: Array) -> Array:
    product = a[:, None, :, None] * b[None, :, None]
    return product.reshape(a.shape[0] * b.shape[0], a.shape[1] * b.shape[1], -1)
