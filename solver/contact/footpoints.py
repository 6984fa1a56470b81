"""Find where points of one line meet the other line, and the derivatives as both lines deform."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from geometry.common.arrays import Bools, Floats, Ints
from solver.contact.boundary_lines import LinePoints, find_points, join_edges, multiply_outer, multiply_symmetric
from solver.contact.kinks import Kinks
from solver.contact.pairs import Pair


@dataclass(frozen=True)
class PointGaps:
    """Gaps of all points of a pair's slave line.

    Attributes
    ----------
    gap
        g of eq. CT.2, m, infinite where the master does not reach, shape (points,).
    place
        Position on the undeformed master line, m from its start; not a number where the master does not reach.
    pair
        The two lines.
    heights
        Coefficients of the deformed master's edges for t and for s, m, shape (k, p + 1) each.
    master_points
        Points of the master line opposite those slave points that it reaches, in their order.
    inside
        Mask of the slave points that the master reaches, shape (points,).
    kinks
        Nodes of the master next to those points.
    """

    pair: Pair
    heights: tuple[Floats, Floats]
    gap: Floats
    place: Floats
    master_points: LinePoints
    inside: Bools
    kinks: Kinks

    @classmethod
    def from_displacements(cls, pair: Pair, displacements: Floats) -> PointGaps:
        """Compute the gaps for displacements of the elements, m, shape (n, 8 p).

        Raises
        ------
        SolveError
            A line folds over.
        """
        value = pair.gauss[1]
        # coordinates t, s of eq. CT.2: of the slave's points, and (mt, ms) coefficients of the master's edges
        t, s = np.einsum("ac,kcp,gp->akg", pair.axes, pair.slave.compute_positions(displacements), value).reshape(2, -1)
        mt, ms = np.einsum("ac,kcp->akp", pair.axes, pair.master.compute_positions(displacements))
        master_points, inside = find_points(mt, t)
        s = s + pair.slave_edge.compute_removed_height(pair.slave_places)[0]
        gap, place, lengths = np.full(len(t), np.inf), np.full(len(t), np.nan), pair.master.lengths
        # edge function 1 is x itself, the position on the edge from 0 to 1
        place[inside] = pair.master.starts[master_points.edge] + lengths[master_points.edge] * master_points.value[:, 1]
        height = (
            np.einsum("jp,jp->j", master_points.value, ms[master_points.edge])
            + pair.master_edge.compute_removed_height(place[inside])[0]
        )
        kinks = Kinks.from_points(pair, (mt, ms), master_points.edge, t[inside])
        gap[inside] = pair.sign * (height + kinks.heights - s[inside])
        return cls(pair, (mt, ms), gap, place, master_points, inside, kinks)

    def select_points(self, active: Bools) -> Footpoints:
        """Return the active points as footpoints; ``active`` is a mask, (points,), of points that the master reaches."""
        pair, selection = self.pair, active[self.inside]
        master_edges = self.master_points.edge[selection]
        value, derivative, bend = (
            x[selection] for x in (self.master_points.value, self.master_points.derivative, self.master_points.bend)
        )
        mt, ms = self.heights
        rise, run = (np.einsum("jp,jp->j", derivative, x[master_edges]) for x in (ms, mt))
        length = pair.master.lengths[master_edges]
        _, tilt, curve = pair.master_edge.compute_removed_height(self.place[active])
        k = np.asarray((rise + length * tilt) / run)
        # derivative of k = (rise + length tilt) / run along the edge
        curl = (np.einsum("jp,jp->j", bend, ms[master_edges] - k[:, None] * mt[master_edges]) + length**2 * curve) / run
        on_slave = pair.gauss[1]
        edge, point = (np.asarray(x) for x in np.divmod(np.flatnonzero(active), len(on_slave)))
        return Footpoints(
            pair, edge, master_edges, on_slave[point], value, derivative, k, run, curl, self.kinks.select_points(selection)
        )


@dataclass(frozen=True)
class Footpoints:
    """Points in contact; x, from 0 to 1, is the position on the master's edge and k = ds/dt the slope of the master there.

    Attributes
    ----------
    slave_edges, master_edges
        Edge of each point on either line, shape (j,) each.
    on_slave, on_master
        Edge functions of both lines at the points, shape (j, p + 1) each.
    derivative
        Derivatives of the master's edge functions with respect to x, shape (j, p + 1).
    k, run, curl
        Derivatives ds/dt, dt/dx and dk/dx of the fixed master line, its kinks left sharp, shape (j,) each.
    kinks
        Nodes of the master next to the points.
    """

    pair: Pair
    slave_edges: Ints
    master_edges: Ints
    on_slave: Floats
    on_master: Floats
    derivative: Floats
    k: Floats
    run: Floats
    curl: Floats
    kinks: Kinks

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
    def opening_direction(self) -> Floats:
        """Directions normal to the master, of rising s and not of unit length, in which an upper master opens the gap, (j, 2)."""
        T, S = self.pair.axes
        return np.asarray(S - self.k[:, None] * T)

    def compute_relative_motion(self, direction: Floats) -> Floats:
        """Return the derivative of the slave's motion relative to the master, at a fixed x, along given directions.

        Parameters
        ----------
        direction
            Directions (r, z) at the points, shape (j, 2).

        Returns
        -------
        Floats
            Derivatives with respect to both lines' values, the slave's before the master's, shape (j, 4 (p + 1)).
        """
        return join_edges(direction[:, :, None] * self.on_slave[:, None], -direction[:, :, None] * self.on_master[:, None])

    def compute_tangent_change(self, direction: Floats) -> Floats:
        """Return the derivative of the master's tangent d(r, z)/dx along directions (j, 2).

        It is taken with respect to both lines' values, shape (j, 4 (p + 1)); those of the slave do not matter.
        """
        moved = direction[:, :, None] * self.derivative[:, None]
        return join_edges(np.zeros_like(moved), moved)

    def differentiate_gap(self) -> tuple[Floats, Floats]:
        """Return the first and second derivatives of the gap g, (j, m) and (j, m, m).

        They are taken with respect to the m = 4 (p + 1) values of both lines, the slave's before the master's. Where a point is
        near a kink of the master, those of the edge beyond it follow for all points: m = 6 (p + 1).
        """
        first, second = -self.compute_relative_motion(self.opening_direction), self._compute_sharp_hessian()
        if self.kinks.any_near:
            m, (whole, whole_second) = first.shape[1], self.kinks.differentiate(self.on_slave)
            whole[:, :m] += first
            whole_second[:, :m, :m] += second
            first, second = whole, whole_second
        return self.pair.sign * first, self.pair.sign * second

    @property
    def place_derivative(self) -> Floats:
        """Derivative of the position x with respect to both lines' values, (j, 4 (p + 1))."""
        return np.asarray(
            self.compute_relative_motion(np.broadcast_to(self.pair.axes[0], self.opening_direction.shape)) / self.run[:, None]
        )

    @property
    def slope_derivative(self) -> Floats:
        """Derivative of the slope k with respect to both lines' values, (j, 4 (p + 1))."""
        return np.asarray(
            self.compute_tangent_change(self.opening_direction) / self.run[:, None] + self.curl[:, None] * self.place_derivative
        )

    def _compute_sharp_hessian(self) -> Floats:
        """Return the second derivative of s of the master minus s of the slave, kinks left sharp, (j, 4 (p + 1), 4 (p + 1))."""
        place_change, turn = self.place_derivative, self.compute_tangent_change(self.opening_direction)
        bend = (self.run * self.curl)[:, None, None] * multiply_outer(place_change, place_change)
        return np.asarray(multiply_symmetric(place_change, turn) + bend)

    def assemble(self, forces: Floats, stiffness: Floats, width: int, size: int) -> tuple[Floats, sp.coo_array]:
        """Assemble the points' forces and stiffness into those on all elements' values.

        Parameters
        ----------
        forces, stiffness
            On the values of ``differentiate_gap`` at each point, shapes (j, m) and (j, m, m).
        width, size
            Number of values of one element, 8 p, and of all elements.

        Returns
        -------
        tuple[Floats, sp.coo_array]
            Forces, shape (size,), and stiffness, sparse, (size, size), whose entries add up.
        """
        index, signs = self._find_indices(width)
        pulls = np.asarray(np.bincount(index.ravel(), weights=(signs * forces).ravel(), minlength=size), dtype=float)
        rows, columns = np.repeat(index, index.shape[1], axis=1), np.tile(index, index.shape[1])
        values = (stiffness * multiply_outer(signs, signs)).ravel()
        return pulls, sp.coo_array((values, (rows.ravel(), columns.ravel())), shape=(size, size))

    def list_gradients(self, width: int) -> tuple[Ints, Floats]:
        """Return the indices of values among all elements' values, and the derivatives of the gap with respect to them, (j, m).

        ``width`` is the number of values of one element; an index may occur twice.
        """
        index, signs = self._find_indices(width)
        return index, signs * self.differentiate_gap()[0]

    def _find_indices(self, width: int) -> tuple[Ints, Floats]:
        """Return the indices of the values of ``differentiate_gap`` among all elements' values, and their signs, (j, m) each.

        An element has ``width`` values; a sign is -1 where a function runs against its line.
        """
        parts = [(self.pair.slave, self.slave_edges), (self.pair.master, self.master_edges)]
        if self.kinks.any_near:
            parts.append((self.pair.master, self.kinks.neighbours))
        places = [line.element[k, None, None] * width + line.values[k] for line, k in parts]
        signs = [np.broadcast_to(line.signs[k][:, None], place.shape) for (line, k), place in zip(parts, places, strict=True)]
        index = np.concatenate([place.reshape(len(place), -1) for place in places], axis=1)
        return index, np.concatenate([sign.reshape(len(sign), -1) for sign in signs], axis=1)
