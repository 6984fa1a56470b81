"""The functions of eqs. CF.8 and CF.9 along a block's height, and the integrals of their products."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from solver.closed_form.bessel import Array

AXIAL, FINE_AXIAL = 2, 3  # functions g_j
HEIGHTS = 10  # nodes of quadrature


@dataclass(frozen=True)
class Along:
    """Integrals over the height of products of f_j and g_j and their derivatives, f_j at the tissue end, all at Gauss's zeta.

    Blocks are last: shapes (functions, functions, n), (functions, n), (nodes, n) and (functions, nodes, n).
    """

    gg: Array
    dg_dg: Array
    g_df: Array
    dg_f: Array
    df_df: Array
    ff: Array
    end: Array
    zeta: Array
    weight: Array
    steep: Array
    g: Array
    dg: Array
    f: Array
    df: Array

    def at(self, share: Array) -> tuple[Array, ...]:
        """g, dg, f and df at shares (n, k) of the height, shapes (n, functions, k)."""
        steep = self.steep[:, None]
        y = np.arctanh((2 * share - 1) * np.tanh(steep)) / steep
        between = np.swapaxes(legendre.legvander(y, HEIGHTS - 1) @ _SERIES, 1, 2)
        return tuple(np.moveaxis(values, 2, 0) @ between for values in (self.g, self.dg, self.f, self.df))


def along_height(height: Array, decay: Array, axial: int) -> Along:
    """Return the integrals of ``axial`` functions g_j for blocks of heights and decays (n,)."""
    y, weight = (one[:, None] for one in _GAUSS)
    h, bh = height, decay * height
    steep = 0.5 * np.log(1 + 0.5 * bh) + 1e-3  # nodes as dense at both ends as the functions need
    turn, whole = np.tanh(steep * y), np.tanh(steep)
    share = (1 + turn / whole) / 2
    dz = (h * steep / (2 * whole)) * (1 - turn * turn)
    zeta, last = h * share, np.exp(-bh)
    loss = 1 - last
    near = np.exp(-decay * zeta)
    far = np.exp(decay * zeta - bh)
    top, fade = (1 - far) / loss, (near - last) / loss
    dtop, dfade = -decay / loss * far, -decay / loss * near
    scale = loss / decay  # of the length over which g_j decays
    rows = np.empty((4 * axial + 2, *zeta.shape), dtype=zeta.dtype)
    parts = [slice(*at) for at in pairwise((0, axial, 2 * axial, 3 * axial + 1, 4 * axial + 2))]
    g, dg, f, df = (rows[part] for part in parts)
    powers = [1 + 0 * top, *accumulate([fade] * (axial - 1), np.multiply)]
    for j, power in enumerate(powers):
        np.multiply(top, power, out=g[j])
        np.multiply(dtop, power, out=dg[j])
        if j:
            dg[j] += j * top * powers[j - 1] * dfade
    weighted = g * dz
    f[0], df[0] = 1 - share, -1 / h
    f[1:] = (_REMAINING @ weighted) / scale  # Int_zeta^h
    np.divide(g, -scale, out=df[1:])
    w = weight * dz
    heavy = rows * w

    def products(one: int, other: int) -> Array:
        return (heavy[parts[one], None] * rows[None, parts[other]]).sum(axis=2)

    end = np.concatenate([1 + 0 * h[None], (weight * weighted).sum(axis=1) / scale])
    return Along(
        products(0, 0),
        products(1, 1),
        g_df=products(0, 3),
        dg_f=products(1, 2),
        df_df=products(3, 3),
        ff=products(2, 2),
        end=end,
        zeta=zeta,
        weight=w,
        steep=steep,
        g=g,
        dg=dg,
        f=f,
        df=df,
    )


def _remaining() -> Any:
    """Integrals from each Gauss node to 1, as weights of the values at the nodes, shape (nodes, nodes)."""
    y, orders = _GAUSS[0], np.arange(HEIGHTS)
    integrals = np.array([legendre.legint(np.eye(HEIGHTS)[n]) for n in orders])
    values = np.array([legendre.legval(1.0, c) - legendre.legval(y, c) for c in integrals])
    return values.T @ _SERIES


_GAUSS = legendre.leggauss(HEIGHTS)
_SERIES = (np.arange(HEIGHTS)[:, None] + 0.5) * legendre.legvander(_GAUSS[0], HEIGHTS - 1).T * _GAUSS[1]
_REMAINING = _remaining()
