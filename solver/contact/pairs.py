r"""Contact of two lines of the section: points of one against the other, frictionless, by augmented Lagrangians.

Both lines are graphs over one coordinate t, and the gap at a point of the softer is the distance along the other coordinate s to
the harder line at the same t. Between the walls of the gap t is z. Where a wall stands on the tissue both lines start at the
block's corner, one upwards and one outwards; over the diagonal t they are graphs, however far the one has folded onto the other:

         wall |    / s        g = s_wall(t) - s_tissue(t)                                          (CT.4)
              |   /
              |  /
       corner +------- tissue       t runs up to the right

The constraint g >= 0 is that of the normal distance; its multiplier, per undeformed area, works along dg, which is normal to the
line. With the multiplier l of the last round and a penalty e the energy of a point is (max(0, l - e g)^2 - l^2) / (2 e) (CT.5).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from geometry.common.arrays import Floats, Ints
from solver.contact.curves import BoundaryLine, find, gauss

ROOT = 0.5**0.5
LEVEL = ((0.0, 1.0), (1.0, 0.0))  # t upwards, s outwards
RISING, FALLING = ((ROOT, ROOT), (-ROOT, ROOT)), ((-ROOT, ROOT), (ROOT, ROOT))  # t up and outwards, or inwards; s up


@dataclass(frozen=True, eq=False)
class Pair:
    """Two lines that may touch.

    Attributes:
        name: for messages.
        slave, master: the softer line, whose points are watched, and the harder.
        axes: unit vectors of t and s, as (r, z), shape (2, 2).
        sign: 1 where the gap is s of the master less that of the slave, else -1.
        penalty: e, Pa/m.
    """

    name: str
    slave: BoundaryLine
    master: BoundaryLine
    axes: Floats
    sign: float
    penalty: float

    @property
    def points(self) -> int:
        """Number of the slave's Gauss points."""
        return int(self.slave.place.shape[0]) * len(gauss(self.slave.order)[0])

    def places(self, own: Floats) -> Floats:
        """The slave's points, deformed, (r, z), m, shape (points, 2)."""
        return np.asarray(np.einsum("kcp,gp->kgc", self.slave.positions(own), gauss(self.slave.order)[1]).reshape(-1, 2))

    def weights(self) -> Floats:
        """2 pi r dL of the undeformed slave at its points, shape (points,)."""
        w, value = gauss(self.slave.order)
        radius = self.slave.place[:, 0] @ value.T
        length = np.linalg.norm(self.slave.place[:, :, 1] - self.slave.place[:, :, 0], axis=1)
        return np.asarray((2 * np.pi * radius * w * length[:, None]).ravel())


@dataclass(frozen=True)
class Touch:
    """A pair in a deformed state.

    Attributes:
        gap: at the slave's points, m, infinite where the master does not reach, shape (points,).
        pressure: of eq. CT.5 there, Pa, per undeformed area and along g, shape (points,).
        forces: on the elements' own values, shape (n (8 p),).
        stiffness: of these, sparse.
    """

    gap: Floats
    pressure: Floats
    forces: Floats
    stiffness: sp.csr_array

    @property
    def closest(self) -> float:
        """The least gap, m."""
        return float(np.min(self.gap, initial=np.inf))


def touch(pair: Pair, own: Floats, multiplier: Floats, share: float = 1.0, blur: float = 0.0) -> Touch:
    """Return gaps, forces and tangent of a pair.

    Args:
        pair: the two lines.
        own: displacements of the elements, m, shape (n, 8 p).
        multiplier: of the last round, Pa, shape (points,).
        share: of the penalty that is used.
        blur: gap, m, over which the kink of eq. CT.5 is rounded.

    Raises:
        SolveError: a line folds over.
    """
    size, penalty = own.size, share * pair.penalty
    value = gauss(pair.slave.order)[1]
    soft, hard = pair.slave.positions(own), pair.master.positions(own)
    t, s = np.einsum("ac,kcp,gp->akg", pair.axes, soft, value).reshape(2, -1)
    mt, ms = np.einsum("ac,kcp->akp", pair.axes, hard)
    found, inside = find(mt, t)
    gap = np.full(len(t), np.inf)
    gap[inside] = pair.sign * (np.einsum("jp,jp->j", found.value, ms[found.edge]) - s[inside])
    pressure, rising = _pressed(multiplier - penalty * np.where(inside, gap, np.inf), penalty * blur)
    active = pressure > 0
    if not np.any(active):
        return Touch(gap, pressure, np.zeros(size), sp.csr_array((size, size)))
    chosen = active[inside]
    at, (value_m, slope_m, bend_m) = found.edge[chosen], (x[chosen] for x in (found.value, found.slope, found.bend))
    rise, run = (np.einsum("jp,jp->j", slope_m, x[at]) for x in (ms, mt))
    k = rise / run
    curl = np.einsum("jp,jp->j", bend_m, ms[at] - k[:, None] * mt[at])
    edge, point = np.divmod(np.flatnonzero(active), len(value))
    T, S = pair.axes
    across = S - k[:, None] * T  # what moves the gap open, on the master
    zero = np.zeros((len(at), 2, value_m.shape[-1]))
    slope = pair.sign * _joined(-across[:, :, None] * value[point][:, None], across[:, :, None] * value_m[:, None])
    along = _joined(T[:, None] * value[point][:, None], -T[:, None] * value_m[:, None]) / run[:, None]
    turn = _joined(zero, across[:, :, None] * slope_m[:, None])
    weight, force = pair.weights()[active], pressure[active]
    stiffness = (weight * penalty * rising[active])[:, None, None] * _outer(slope, slope)
    second = _outer(along, turn) + _outer(turn, along) + curl[:, None, None] * _outer(along, along)
    stiffness -= (weight * force * pair.sign)[:, None, None] * second
    index, signs = _numbers(pair, edge, at, own.shape[1])
    pulls = (signs * slope * (-weight * force)[:, None]).ravel()
    forces = np.asarray(np.bincount(index.ravel(), weights=pulls, minlength=size), dtype=float)
    stiffness *= _outer(signs, signs)
    rows, columns = np.broadcast_arrays(index[:, :, None], index[:, None, :])
    matrix = sp.csr_array(sp.coo_array((stiffness.ravel(), (rows.ravel(), columns.ravel())), shape=(size, size)))
    return Touch(gap, pressure, forces, matrix)


def _pressed(trial: Floats, blur: float) -> tuple[Floats, Floats]:
    """max(0, trial) with its kink rounded between -blur and blur, and its slope."""
    low, high = trial <= -blur, trial >= blur
    between = (np.clip(trial, -blur, blur) + blur) / (2 * blur)
    return np.where(low, 0.0, np.where(high, trial, blur * between**2)), np.where(low, 0.0, np.where(high, 1.0, between))


def _joined(slave: Floats, master: Floats) -> Floats:
    """One vector of both lines' values, (j, 4 (p + 1))."""
    return np.concatenate([slave.reshape(len(slave), -1), master.reshape(len(master), -1)], axis=1)


def _outer(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[:, :, None] * b[:, None, :])


def _numbers(pair: Pair, edge: Ints, at: Ints, width: int) -> tuple[Ints, Floats]:
    """Places of both lines' values among all elements' own, and their signs, shape (j, 4 (p + 1)) each."""
    parts = ((pair.slave, edge), (pair.master, at))
    places = [line.element[k, None, None] * width + line.values[k] for line, k in parts]
    signs = [np.broadcast_to(line.signs[k][:, None], place.shape) for (line, k), place in zip(parts, places, strict=True)]
    index = np.concatenate([place.reshape(len(place), -1) for place in places], axis=1)
    return index, _joined(*signs)
