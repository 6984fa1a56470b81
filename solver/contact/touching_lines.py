r"""Find the pairs of lines of a section that may touch.

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

from dataclasses import dataclass, replace

import numpy as np

from geometry.meridian.mesh import Topology, compute_nodes
from geometry.meridian.mesh_cells import UNIT_SQUARE
from geometry.meridian.section import Body, Section
from geometry.scenes.probe import Interface
from solver.axisymmetric.base_states import Materials
from solver.contact.boundary_lines import BoundaryLine, find_lines
from solver.contact.pairs import GAP_AXES, INWARD_AXES, OUTWARD_AXES, Axes, Pair, RoundEdge

MAX_CONTACT_LENGTH_RELATIVE = 0.02  # of the outer radius: the contact length does not grow with wider gaps
SHARP_EDGE_RADIUS_RELATIVE = 0.06  # radius that stands for a sharp edge, in elements: points pass it smoothly
PENALTY_FACTOR = 1000.0  # penalty in moduli of the softer body per length of its elements at the line


@dataclass(frozen=True)
class Side:
    """A line that may touch another: the part with contact points, and the part that the other line's points may meet.

    ``corners``: positions on both parts where a block's face ends and its wall begins, m.
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
    """Return the pairs: first the walls of the gap, then each wall with the tissue next to it, the outermost last.

    Faces that are not bonded belong to the line of their wall and have ``friction``. Each edge has one Gauss point more than its
    order, or twice as many if ``dense``.
    """
    lines = find_lines(mesh, compute_nodes(section, mesh, UNIT_SQUARE), order)
    points = (2 if dense else 1) * (order + 1)
    plan = _list_wall_sides(lines) if faces == "bonded" else _list_face_sides(lines)
    inner, hole = (Side(lines[name], lines[name]) for name in ("inner wall", "hole wall"))
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
    """Build a pair: the softer line is the slave; the gap is s of the upper line minus s of the lower line."""
    soft, hard = (materials[Body(mesh.body[side.watched.element[0]])].youngs_modulus for side in (lower, upper))
    swapped = hard < soft
    slave, master = (upper, lower) if swapped else (lower, upper)
    penalty = PENALTY_FACTOR * min(soft, hard) / float(slave.watched.lengths.min())
    return Pair(name, slave.watched, master.met, np.array(axes), -1.0 if swapped else 1.0, penalty, points)


def _round_edge(pair: Pair, block: Side, radius: float) -> Pair:
    """Return a pair whose block has a round edge."""
    watched, met = (RoundEdge(place, radius) for place in block.corners)
    if pair.slave is block.watched:
        return replace(pair, slave_edge=watched)
    return replace(pair, master_edge=met)


def _build_loose_pair(pair: Pair, tissue: Side, block: Side, radius: float, *, faces: Interface, friction: float) -> Pair:
    """Return a pair of faces that may open or slide; a sharp edge gets a small radius."""
    sharp = SHARP_EDGE_RADIUS_RELATIVE * float(min(pair.slave.lengths.min(), pair.master.lengths.min()))
    face = (block if pair.slave is block.watched else tissue).corners[0]
    tied = pair.slave_places < face - radius if faces == "frictionless" else pair.tied  # what rises to a round edge is free
    return replace(_round_edge(pair, block, radius or sharp), loose=True, friction=friction, tied=tied)
