"""Find where points of one line meet the other line, and the derivatives as both lines deform."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from geometry.common.arrays import Bools, Floats, Ints
from solver.contact.curves import Found, find, gauss
from solver.contact.pairs import Pair


@dataclass(frozen=True)
class Feet:
    """Gaps of all points of a pair's slave line.

    Attributes:
        gap: g of eq. CT.4, m, infinite where the master does not reach, shape (points,).
        place: position on the undeformed master line, m from its start; not a number where the master does not reach.
    """

    pair: Pair
    own: Floats
    gap: Floats
    place: Floats
    found: Found
    inside: Bools

    @classmethod
    def of(cls, pair: Pair, own: Floats) -> Feet:
        """Compute the gaps for displacements of the elements, m, shape (n, 8 p).

        Raises:
            SolveError: a line folds over.
        """
        value = gauss(pair.slave.order)[1]
        t, s = np.einsum("ac,kcp,gp->akg", pair.axes, pair.slave.positions(own), value).reshape(2, -1)
        mt, ms = np.einsum("ac,kcp->akp", pair.axes, pair.master.positions(own))
        found, inside = find(mt, t)
        s = s + pair.slave_edge.taken(pair.along)[0]
        gap, place, lengths = np.full(len(t), np.inf), np.full(len(t), np.nan), pair.master.lengths
        starts = np.cumsum(lengths) - lengths
        place[inside] = starts[found.edge] + lengths[found.edge] * found.value[:, 1]  # x itself
        height = np.einsum("jp,jp->j", found.value, ms[found.edge]) + pair.master_edge.taken(place[inside])[0]
        gap[inside] = pair.sign * (height - s[inside])
        return cls(pair, own, gap, place, found, inside)

    def chosen(self, active: Bools) -> Footpoints:
        """Return selected points with their derivatives; ``active``, (points,), selects among those that the master reaches."""
        pair, here = self.pair, active[self.inside]
        at = self.found.edge[here]
        value, slope, bend = (x[here] for x in (self.found.value, self.found.slope, self.found.bend))
        mt, ms = np.einsum("ac,kcp->akp", pair.axes, pair.master.positions(self.own))
        rise, run = (np.einsum("jp,jp->j", slope, x[at]) for x in (ms, mt))
        length = pair.master.lengths[at]
        _, tilt, curve = pair.master_edge.taken(self.place[active])
        k = np.asarray((rise + length * tilt) / run)
        curl = (np.einsum("jp,jp->j", bend, ms[at] - k[:, None] * mt[at]) + length**2 * curve) / run
        on_slave = gauss(pair.slave.order)[1]
        edge, point = (np.asarray(x) for x in np.divmod(np.flatnonzero(active), len(on_slave)))
        return Footpoints(pair, edge, at, on_slave[point], value, slope, k, run, curl)


@dataclass(frozen=True)
class Footpoints:
    """Points in contact; x, from 0 to 1, is the position on the master's edge and k = ds/dt the slope of the master there.

    Attributes:
        slave_edges, master_edges: edge of each point on either line, shape (j,) each.
        on_slave, on_master: edge functions of both lines at the points, shape (j, p + 1) each.
        slope: derivatives of the master's edge functions with respect to x, shape (j, p + 1).
        k, run, curl: ds/dt, dt/dx and dk/dx of the fixed master line, shape (j,) each.
    """

    pair: Pair
    edge: Ints
    at: Ints
    on_slave: Floats
    on_master: Floats
    slope: Floats
    k: Floats
    run: Floats
    curl: Floats

    @property
    def stretch(self) -> Floats:
        """Length of the master line per unit t, shape (j,)."""
        return np.sqrt(1 + self.k**2)

    @property
    def tangent(self) -> Floats:
        """Unit vectors along the master, shape (j, 2)."""
        T, S = self.pair.axes
        return np.asarray((T + self.k[:, None] * S) / self.stretch[:, None])

    @property
    def across(self) -> Floats:
        """Direction, normal to the master, in which it moves to open the gap, shape (j, 2)."""
        T, S = self.pair.axes
        return np.asarray(S - self.k[:, None] * T)

    def apart(self, direction: Floats) -> Floats:
        """Return the slave's motion relative to the master along directions (j, 2), by both lines' values, (j, 4 (p + 1))."""
        return _joined(direction[:, :, None] * self.on_slave[:, None], -direction[:, :, None] * self.on_master[:, None])

    def turned(self, direction: Floats) -> Floats:
        """Return the change of the master's x derivative along directions (j, 2), by both lines' values."""
        moved = direction[:, :, None] * self.slope[:, None]
        return _joined(np.zeros_like(moved), moved)

    @property
    def opening(self) -> Floats:
        """Derivative of the gap g with respect to both lines' values, (j, 4 (p + 1))."""
        return -self.pair.sign * self.apart(self.across)

    @property
    def along(self) -> Floats:
        """Derivative of the position x with respect to both lines' values, (j, 4 (p + 1))."""
        return np.asarray(self.apart(np.broadcast_to(self.pair.axes[0], self.across.shape)) / self.run[:, None])

    @property
    def tilt(self) -> Floats:
        """Derivative of the slope k with respect to both lines' values, (j, 4 (p + 1))."""
        return np.asarray(self.turned(self.across) / self.run[:, None] + self.curl[:, None] * self.along)

    def opening_twice(self) -> Floats:
        """Return the second derivative of the gap with respect to both lines' values, (j, 4 (p + 1), 4 (p + 1))."""
        along, turn = self.along, self.turned(self.across)
        bend = (self.run * self.curl)[:, None, None] * outer(along, along)
        return np.asarray(self.pair.sign * (outer(along, turn) + outer(turn, along) + bend))

    def assembled(self, forces: Floats, stiffness: Floats, width: int, size: int) -> tuple[Floats, sp.csr_array]:
        """Assemble both lines' forces and stiffness into those of all elements' values, ``width`` for each, ``size`` in all."""
        index, signs = self._numbers(width)
        pulls = np.asarray(np.bincount(index.ravel(), weights=(signs * forces).ravel(), minlength=size), dtype=float)
        rows, columns = np.broadcast_arrays(index[:, :, None], index[:, None, :])
        values = (stiffness * outer(signs, signs)).ravel()
        return pulls, sp.csr_array(sp.coo_array((values, (rows.ravel(), columns.ravel())), shape=(size, size)))

    def _numbers(self, width: int) -> tuple[Ints, Floats]:
        """Return the indices of both lines' values among all elements' values, and their signs, shape (j, 4 (p + 1)) each."""
        parts = ((self.pair.slave, self.edge), (self.pair.master, self.at))
        places = [line.element[k, None, None] * width + line.values[k] for line, k in parts]
        signs = [np.broadcast_to(line.signs[k][:, None], place.shape) for (line, k), place in zip(parts, places, strict=True)]
        index = np.concatenate([place.reshape(len(place), -1) for place in places], axis=1)
        return index, _joined(*signs)


def outer(a: Floats, b: Floats) -> Floats:
    """Return the outer products of vectors: (j, n) and (j, m) give (j, n, m)."""
    return np.asarray(a[:, :, None] * b[:, None, :])


def _joined(slave: Floats, master: Floats) -> Floats:
    """Join rows over the slave's and the master's values to one row, (j, 4 (p + 1))."""
    return np.concatenate([slave.reshape(len(slave), -1), master.reshape(len(master), -1)], axis=1)
