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
    """Integrals over the height of products of f_j and g_j and their derivatives; f_j at the tissue end; all at Gauss's zeta."""

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
        y = np.arctanh((2 * share - 1) * np.tanh(self.steep)) / self.steep
        between = np.swapaxes(legendre.legvander(y, HEIGHTS - 1) @ _SERIES, 1, 2)
        return tuple(values @ between for values in (self.g, self.dg, self.f, self.df))


def along_height(height: Array, decay: Array, axial: int) -> Along:
    """Return the integrals of ``axial`` functions g_j for blocks of heights and decays (n,)."""
    y, weight = _GAUSS
    h = height[:, None]
    decay = decay[:, None]
    bh = decay * h
    steep = 0.5 * np.log(1 + 0.5 * bh) + 1e-3  # nodes as dense at both ends as the functions need
    turn = np.tanh(steep * y)
    share = (1 + turn / np.tanh(steep)) / 2
    dz = h * steep / (2 * np.tanh(steep)) * (1 - turn * turn)
    zeta = h * share
    loss = 1 - np.exp(-bh)
    far, near = np.exp(-decay * (h - zeta)), np.exp(-decay * zeta)
    top, fade = (1 - far) / loss, (near - np.exp(-bh)) / loss
    dtop, dfade = -decay / loss * far, -decay / loss * near
    powers = [1 + 0 * top, *accumulate([fade] * (axial - 1), np.multiply)]
    g = np.stack([top * power for power in powers], axis=1)
    slopes = [dtop, *(dtop * powers[j] + j * top * powers[j - 1] * dfade for j in range(1, axial))]
    dg = np.stack(slopes, axis=1)
    scale = loss / decay  # of the length over which g_j decays
    below = _REMAINING * dz[:, None, :]  # weights of Int_zeta^h
    f = np.concatenate([(1 - share)[:, None, :], (g @ np.swapaxes(below, 1, 2)) / scale[:, None]], axis=1)
    df = np.concatenate([0 * share[:, None, :] - 1 / h[:, None], -g / scale[:, None]], axis=1)
    w = (weight * dz)[:, None, :]
    rows = np.concatenate([g, dg, f, df], axis=1)
    pairs = (rows * w) @ np.swapaxes(rows, 1, 2)
    at_g, at_dg, at_f, at_df = (slice(*at) for at in pairwise((0, axial, 2 * axial, 3 * axial + 1, 4 * axial + 2)))
    end = np.concatenate([0 * h + 1, (g @ (weight * dz)[:, :, None])[:, :, 0] / scale], axis=1)
    return Along(
        pairs[:, at_g, at_g],
        pairs[:, at_dg, at_dg],
        g_df=pairs[:, at_g, at_df],
        dg_f=pairs[:, at_dg, at_f],
        df_df=pairs[:, at_df, at_df],
        ff=pairs[:, at_f, at_f],
        end=end,
        zeta=zeta,
        weight=w[:, 0],
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
