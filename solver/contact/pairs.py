r"""Find the pairs of lines of a section that may touch: points of the softer line against the harder line.

Both lines are graphs over one coordinate t. The gap at a point of the softer line is the distance along the other coordinate s to
the harder line at the same t. Between the walls of the gap t is z. Where a wall stands on the tissue both lines start at the
block's corner, one upwards and one outwards; over the diagonal t they are graphs, however far the one has folded onto the other:

         wall |    / s        g = s_wall(t) - s_tissue(t)                                          (CT.2)
              |   /
              |  /
       corner +------- tissue       t runs up to the right

With bonded faces, only walls may touch: each with the tissue next to it, from the block's corner, or from where the face ends at
a round edge. Faces that may open or slide are one line with their walls, which is a graph over the diagonal like the wall alone:
points pass the corner without leaving their line. The tube's face belongs to both its walls: its points are shared out at its
middle, each half against the whole face.

                 |          |              |
    inner block  |          |     tube     |
    ----face-----+  strip   +--- : face ---+  top
    ------------------->    <----:--------------->      directions of the three lines of the tissue, with their walls upwards
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.meridian.mesh import Topology, compute_nodes
from geometry.meridian.mesh_cells import UNIT_SQUARE
from geometry.meridian.section import Body, Section
from geometry.scenes.probe import Interface
from solver.axisymmetric.base_states import Materials
from solver.contact.boundary_lines import BoundaryLine, find_lines, tabulate_gauss

ROOT_HALF = 0.5**0.5
Axes = tuple[tuple[float, float], tuple[float, float]]
GAP_AXES: Axes = ((0.0, 1.0), (1.0, 0.0))  # t upwards, s outwards
OUTWARD_AXES, INWARD_AXES = (
    ((ROOT_HALF, ROOT_HALF), (-ROOT_HALF, ROOT_HALF)),
    ((-ROOT_HALF, ROOT_HALF), (ROOT_HALF, ROOT_HALF)),
)  # t up and outwards, or inwards; s up
MAX_CONTACT_LENGTH_RELATIVE = 0.02  # of the outer radius: the contact length does not grow with wider gaps
SHARP_EDGE_RADIUS_RELATIVE = 0.06  # radius that stands for a sharp edge, in elements: points pass it smoothly
PENALTY_FACTOR = 1000.0  # penalty in moduli of the softer body per length of its elements at the line


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
        # face and wall rise at 45 deg to the diagonal t on either side of the corner; the arc lies between
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
        Name for messages.
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
        f of eq. CT.6, as a fraction of the penalty.
    slave_edge, master_edge
        Rounded edge of the block, on whichever line is the block's; the other has none.
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

    @cached_property
    def gauss(self) -> tuple[Floats, Floats]:
        """Weights, (g,), and edge functions, (g, p + 1), at the g Gauss points of an edge of the slave."""
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
        along = self.slave.lengths[:, None] * self.gauss[1][:, 1]
        return np.asarray((self.slave.starts[:-1, None] + along).ravel())  # function 1 is the position on the edge, 0 to 1

    @cached_property
    def weights(self) -> Floats:
        """Areas 2 pi r dL of the undeformed slave at its points, m^2, shape (points,)."""
        w, value = self.gauss
        radius = self.slave.place[:, 0] @ value.T
        return np.asarray((2 * np.pi * radius * w * self.slave.lengths[:, None]).ravel())


@dataclass(frozen=True)
class Side:
    """A line that may touch another.

    Attributes
    ----------
    watched
        The part that has contact points if this line is the slave.
    met
        The part that the other line's points may meet if this line is the master.
    corners
        Positions on both parts where a block's face ends and its wall begins, m from their start; infinite if there is none.
    """

    watched: BoundaryLine
    met: BoundaryLine
    corners: tuple[float, float] = (np.inf, np.inf)


def compute_contact_length(section: Section) -> float:
    """Return the length, m, to which penetration and rounding are relative: the gap, or a fraction of the probe's radius."""
    return min(float(section.hole_radius - section.inner_radius), MAX_CONTACT_LENGTH_RELATIVE * float(section.tube_radius))


def find_pairs(
    section: Section,
    materials: Materials,
    mesh: Topology,
    order: int,
    *,
    faces: Interface = "bonded",
    friction: float = 0.0,
    dense: bool = False,
) -> tuple[Pair, ...]:
    """Return the pairs of lines that may touch: first the walls of the gap, then each wall with its tissue, the outermost last.

    Parameters
    ----------
    section, materials, mesh
        The section, its materials, and its elements.
    order
        Polynomial order p of the elements.
    faces
        How the blocks' faces hold to the tissue; faces that are not bonded belong to the line of their wall.
    friction
        Coulomb's coefficient on faces that open.
    dense
        Whether each edge has 2 (p + 1) contact points (Gauss points) instead of p + 1.
    """
    lines = find_lines(mesh, compute_nodes(section, mesh, UNIT_SQUARE), order)
    points = (2 if dense else 1) * (order + 1)
    plan = _list_wall_sides(lines) if faces == "bonded" else _list_face_sides(lines)
    inner, hole = (Side(lines[name], lines[name]) for name in ("inner wall", "hole wall"))
    # first pair: inner block's wall and hole's wall
    gap, radius = (
        _build_pair("walls of the gap", inner, hole, GAP_AXES, materials=materials, mesh=mesh, points=points),
        float(section.edge_radius),
    )
    side_pairs = [(_build_pair(*row, materials=materials, mesh=mesh, points=points), row[1], row[2]) for row in plan]
    if faces == "bonded":
        return (gap, *(_round_edge(pair, upper, radius) for pair, _, upper in side_pairs))
    return (
        gap,
        *(_build_loose_pair(pair, lower, upper, radius, faces=faces, friction=friction) for pair, lower, upper in side_pairs),
    )


def _list_wall_sides(lines: dict[str, BoundaryLine]) -> tuple[tuple[str, Side, Side, Axes], ...]:
    """List the pairs next to bonded faces: names, lower and upper lines, directions."""
    strip, top = lines["open strip"], lines["open top"]

    def build_wall_side(block: str) -> Side:
        """Return a block's wall; where its edge is round, from the end of the face on."""
        line, lip = lines[f"{block} wall"], lines.get(f"{block} lip")
        if lip is None:
            return Side(line, line)
        whole, corner = (lip.reverse() if block == "hole" else lip).join(line), float(lip.lengths.sum())
        return Side(whole, whole, (corner, corner))

    return (
        ("inner wall and strip", Side(strip, strip), build_wall_side("inner"), OUTWARD_AXES),
        ("hole wall and strip", Side(strip.reverse(), strip.reverse()), build_wall_side("hole"), INWARD_AXES),
        ("tube wall and tissue", Side(top, top), build_wall_side("tube"), OUTWARD_AXES),
    )


def _list_face_sides(lines: dict[str, BoundaryLine]) -> tuple[tuple[str, Side, Side, Axes], ...]:
    """List the pairs of faces that slide or open, with their walls; see ``_list_wall_sides``."""
    under_tube, face, strip = lines["under tube"], lines["tube face"], lines["strip"]
    middle = len(face.element) // 2

    def join_side(part: BoundaryLine, whole: BoundaryLine, continuation: BoundaryLine) -> Side:
        """Return the side of a face and the line that continues it: ``part`` of the face has contact points, ``whole`` is met."""
        return Side(part.join(continuation), whole.join(continuation), (float(part.lengths.sum()), float(whole.lengths.sum())))

    inner = join_side(lines["inner face"], lines["inner face"], lines["inner wall"])
    tissue_inner = join_side(lines["under inner"], lines["under inner"], strip)
    hole = join_side(face.take_edges(0, middle).reverse(), face.reverse(), lines["hole wall"])
    tube = join_side(face.take_edges(middle), face, lines["tube wall"])
    inwards = join_side(under_tube.take_edges(0, middle).reverse(), under_tube.reverse(), strip.reverse())
    outwards = join_side(under_tube.take_edges(middle), under_tube, lines["top"])
    return (
        ("inner block and tissue", tissue_inner, inner, OUTWARD_AXES),
        ("hole of the tube and tissue", inwards, hole, INWARD_AXES),
        ("tube and tissue", outwards, tube, OUTWARD_AXES),
    )


def _build_pair(name: str, lower: Side, upper: Side, axes: Axes, *, materials: Materials, mesh: Topology, points: int) -> Pair:
    """Build a pair of a lower and an upper line: the softer is the slave.

    The gap is s of the upper line minus s of the lower line (eq. CT.2); ``axes`` are the directions of t and s, and ``points``
    is the number of contact points on each edge.
    """
    soft, hard = (materials[Body(mesh.body[side.watched.element[0]])].youngs_modulus for side in (lower, upper))
    swapped = hard < soft
    slave, master = (upper, lower) if swapped else (lower, upper)
    penalty = PENALTY_FACTOR * min(soft, hard) / float(slave.watched.lengths.min())
    return Pair(name, slave.watched, master.met, np.array(axes), -1.0 if swapped else 1.0, penalty, points)


def _round_edge(pair: Pair, block: Side, radius: float) -> Pair:
    """Return the pair with the block's round edge of ``radius``, m, on the slave or the master, whichever is the block's line."""
    edge_as_slave, edge_as_master = (RoundEdge(place, radius) for place in block.corners)
    if pair.slave is block.watched:
        return replace(pair, slave_edge=edge_as_slave)
    return replace(pair, master_edge=edge_as_master)


def _build_loose_pair(pair: Pair, tissue: Side, block: Side, radius: float, *, faces: Interface, friction: float) -> Pair:
    """Return the pair of a block's face and the tissue that may open or slide; a sharp edge, radius 0, gets a small radius."""
    sharp = SHARP_EDGE_RADIUS_RELATIVE * float(min(pair.slave.lengths.min(), pair.master.lengths.min()))
    face = (block if pair.slave is block.watched else tissue).corners[0]
    tied = pair.slave_places < face - radius if faces == "frictionless" else pair.tied  # what rises to a round edge is free
    return replace(_round_edge(pair, block, radius or sharp), loose=True, friction=friction, tied=tied)
