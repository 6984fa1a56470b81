r"""Describe pairs of lines that may touch: points of the softer line against the harder line.

Both lines are graphs over one coordinate t. The gap at a point of the softer line is the distance along the other coordinate s to
the harder line at the same t. Between the walls of the gap t is z. Where a wall stands on the tissue both lines start at the
block's corner, one upwards and one outwards; over the diagonal t they are graphs, however far the one has folded onto the other:

         wall |    / s        g = s_wall(t) - s_tissue(t)                                          (CT.2)
              |   /
              |  /
       corner +------- tissue       t runs up to the right
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from geometry.common.arrays import Bools, Floats
from solver.contact.boundary_lines import BoundaryLine, tabulate_gauss

ROOT_HALF = 0.5**0.5
Axes = tuple[tuple[float, float], tuple[float, float]]
GAP_AXES: Axes = ((0.0, 1.0), (1.0, 0.0))  # t upwards, s outwards
OUTWARD_AXES, INWARD_AXES = (
    ((ROOT_HALF, ROOT_HALF), (-ROOT_HALF, ROOT_HALF)),
    ((-ROOT_HALF, ROOT_HALF), (ROOT_HALF, ROOT_HALF)),
)  # t up and outwards, or inwards; s up


@dataclass(frozen=True)
class RoundEdge:
    """A block's rounded lower edge: the height that it removes from the block's line, along s.

    Attributes
    ----------
    place
        Position of the corner on the undeformed line, m from its start; infinite if there is none.
    radius
        Edge radius, m.
    """

    place: float = np.inf
    radius: float = 0.0

    def compute_removed_height(self, place: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the removed height, m, at positions on the line, and its first and second derivatives along it."""
        if not self.radius:
            return (np.zeros_like(place),) * 3
        t = np.clip((place - self.place) * ROOT_HALF, -ROOT_HALF * self.radius, ROOT_HALF * self.radius)
        on_arc = np.abs(t) < ROOT_HALF * self.radius
        height = np.sqrt(self.radius**2 - t**2)
        first = ROOT_HALF * (t / height - np.copysign(1.0, place - self.place))
        second = 0.5 * self.radius**2 / height**3
        removed = self.radius / ROOT_HALF - height - np.abs(t)
        return np.where(on_arc, removed, 0.0), np.where(on_arc, first, 0.0), np.where(on_arc, second, 0.0)


@dataclass(frozen=True, eq=False)
class Pair:
    """Two lines that may touch.

    Attributes
    ----------
    name
        For messages.
    slave, master
        The softer line, whose points are checked, and the harder line.
    axes
        Unit vectors of t and s, as (r, z), shape (2, 2).
    sign
        1 if the gap is s of the master minus s of the slave, else -1.
    penalty
        Penalty e of eq. CT.3, Pa/m.
    points_per_edge
        Gauss points on each edge of the slave.
    loose
        Whether lines lie on each other from the start, faces that may open.
    friction
        Coulomb's coefficient.
    spring
        f of eq. CT.6, in penalties.
    slave_edge, master_edge
        Of the block on either line.
    tied
        Mask of the slave's points that cannot leave the master, shape (points,); empty if there are none.
    """

    name: str
    slave: BoundaryLine
    master: BoundaryLine
    axes: Floats
    sign: float
    penalty: float
    points_per_edge: int
    loose: bool = False
    friction: float = 0.0
    spring: float = 0.0
    slave_edge: RoundEdge = RoundEdge()
    master_edge: RoundEdge = RoundEdge()
    tied: Bools = field(default_factory=lambda: np.zeros(0, dtype=bool))

    @property
    def smooth(self) -> bool:
        """Whether the lines touch at rest or separate smoothly, so that penetration matters at any load."""
        return self.loose or self.slave_edge.radius > 0 or self.master_edge.radius > 0

    @property
    def gauss(self) -> tuple[Floats, Floats]:
        """Weights (g,) and functions (g, p + 1) at the Gauss points of an edge of the slave."""
        return tabulate_gauss(self.slave.order, self.points_per_edge)

    @property
    def points(self) -> int:
        """Number of the slave's Gauss points."""
        return int(self.slave.place.shape[0]) * self.points_per_edge

    def compute_positions(self, displacements: Floats) -> Floats:
        """Return the deformed positions (r, z) of the slave's points, m, shape (points, 2)."""
        return np.asarray(np.einsum("kcp,gp->kgc", self.slave.compute_positions(displacements), self.gauss[1]).reshape(-1, 2))

    @cached_property
    def slave_places(self) -> Floats:
        """Positions of the slave's points on the undeformed line, m from its start, shape (points,)."""
        lengths = self.slave.lengths[:, None]
        starts = np.cumsum(lengths)[:, None] - lengths
        return np.asarray((starts + lengths * self.gauss[1][:, 1]).ravel())

    @cached_property
    def weights(self) -> Floats:
        """Areas 2 pi r dL of the undeformed slave at its points, m^2, shape (points,)."""
        w, value = self.gauss
        radius = self.slave.place[:, 0] @ value.T
        return np.asarray((2 * np.pi * radius * w * self.slave.lengths[:, None]).ravel())
