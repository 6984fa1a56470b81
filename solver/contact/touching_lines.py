r"""Find the pairs of lines of a section that may touch.

Bonded faces leave the walls: each with the tissue beside it, from the block's corner, or from where the face ends at a round
edge. Faces that may open or slide are one line with their walls, which is a graph over the diagonal like the wall alone: points
pass the corner without leaving their line. The tube's face belongs to both its walls: its points are shared out at its middle,
each half against the whole face.

                 |          |              |
    inner block  |          |     tube     |
    ----face-----+  strip   +--- : face ---+  top
    ------------------->    <----:--------------->      directions of the three lines of the tissue, with their walls upwards
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geometry.meridian.mesh import SQUARE, Topology, nodes
from geometry.meridian.section import Body, Section
from geometry.scenes.probe import Interface
from solver.axisymmetric.base_states import Materials
from solver.contact.curves import BoundaryLine, lines_of
from solver.contact.pairs import FALLING, LEVEL, RISING, Axes, Pair, RoundEdge

NARROW = 0.02  # of the outer radius: the contact length does not grow with wider gaps
SHARP = 0.06  # radius that stands for a sharp edge, in elements: points pass it smoothly
STIFF = 1000.0  # penalty in moduli of the softer body per length of its elements at the line


@dataclass(frozen=True)
class Side:
    """A line that may touch another: the part with contact points, and the part that the other line's points may meet.

    ``corners``: positions on both parts where a block's face ends and its wall begins, m.
    """

    watched: BoundaryLine
    met: BoundaryLine
    corners: tuple[float, float] = (np.inf, np.inf)


def contact_length(section: Section) -> float:
    """Return the length, m, to which penetration and rounding are relative: the gap, or a share of the probe's radius."""
    return min(float(section.hole_radius - section.inner_radius), NARROW * float(section.tube_radius))


def pairs_of(
    section: Section, materials: Materials, mesh: Topology, order: int, *, faces: Interface = "bonded", friction: float = 0.0
) -> tuple[Pair, ...]:
    """Return the pairs: first the walls of the gap, then each wall with the tissue next to it, the outermost last.

    Faces that are not bonded belong to the line of their wall and have ``friction``.
    """
    lines = lines_of(mesh, nodes(section, mesh, SQUARE), order)
    plan = _beside_walls(lines) if faces == "bonded" else _with_faces(lines)
    inner, hole = (Side(lines[name], lines[name]) for name in ("inner wall", "hole wall"))
    gap, radius = _pair("walls of the gap", inner, hole, LEVEL, materials=materials, mesh=mesh), float(section.edge_radius)
    rest = [(_pair(*row, materials=materials, mesh=mesh), row[1], row[2]) for row in plan]
    if faces == "bonded":
        return (gap, *(_rounded(pair, above, radius) for pair, _, above in rest))
    return (gap, *(_loose(pair, below, above, radius, faces=faces, friction=friction) for pair, below, above in rest))


def _beside_walls(lines: dict[str, BoundaryLine]) -> tuple[tuple[str, Side, Side, Axes], ...]:
    """List the pairs next to bonded faces: names, lower and upper lines, directions."""
    strip, top = lines["open strip"], lines["open top"]

    def wall(block: str) -> Side:
        line, lip = lines[f"{block} wall"], lines.get(f"{block} lip")
        if lip is None:
            return Side(line, line)
        whole, corner = (lip.reversed() if block == "hole" else lip).followed_by(line), float(lip.lengths.sum())
        return Side(whole, whole, (corner, corner))

    return (
        ("inner wall and strip", Side(strip, strip), wall("inner"), RISING),
        ("hole wall and strip", Side(strip.reversed(), strip.reversed()), wall("hole"), FALLING),
        ("tube wall and tissue", Side(top, top), wall("tube"), RISING),
    )


def _with_faces(lines: dict[str, BoundaryLine]) -> tuple[tuple[str, Side, Side, Axes], ...]:
    """List the pairs of faces that slide or open, with their walls; see ``_list_wall_sides``."""
    under, face, strip = lines["under tube"], lines["tube face"], lines["strip"]
    middle = len(face.element) // 2

    def half(part: BoundaryLine, whole: BoundaryLine, on: BoundaryLine) -> Side:
        return Side(part.followed_by(on), whole.followed_by(on), (float(part.lengths.sum()), float(whole.lengths.sum())))

    inner = half(lines["inner face"], lines["inner face"], lines["inner wall"])
    beside = half(lines["under inner"], lines["under inner"], strip)
    hole = half(face.part(0, middle).reversed(), face.reversed(), lines["hole wall"])
    tube = half(face.part(middle), face, lines["tube wall"])
    inwards = half(under.part(0, middle).reversed(), under.reversed(), strip.reversed())
    outwards = half(under.part(middle), under, lines["top"])
    return (
        ("inner block and tissue", beside, inner, RISING),
        ("hole of the tube and tissue", inwards, hole, FALLING),
        ("tube and tissue", outwards, tube, RISING),
    )


def _pair(name: str, below: Side, above: Side, axes: Axes, *, materials: Materials, mesh: Topology) -> Pair:
    """Build a pair: the softer line is the slave; the gap is s of the upper line minus s of the lower line."""
    soft, hard = (materials[Body(mesh.body[side.watched.element[0]])].youngs_modulus for side in (below, above))
    swapped = hard < soft
    slave, master = (above, below) if swapped else (below, above)
    penalty = STIFF * min(soft, hard) / float(slave.watched.lengths.min())
    return Pair(name, slave.watched, master.met, np.array(axes), -1.0 if swapped else 1.0, penalty)


def _rounded(pair: Pair, block: Side, radius: float) -> Pair:
    """Return a pair whose block has a round edge."""
    watched, met = (RoundEdge(place, radius) for place in block.corners)
    if pair.slave is block.watched:
        return replace(pair, slave_edge=watched)
    return replace(pair, master_edge=met)


def _loose(pair: Pair, tissue: Side, block: Side, radius: float, *, faces: Interface, friction: float) -> Pair:
    """Return a pair of faces that may open or slide; a sharp edge gets a small radius."""
    sharp = SHARP * float(min(pair.slave.lengths.min(), pair.master.lengths.min()))
    face = (block if pair.slave is block.watched else tissue).corners[0]
    tied = pair.along < face - radius if faces == "frictionless" else pair.tied  # what rises to a round edge is free
    return replace(_rounded(pair, block, radius or sharp), loose=True, friction=friction, tied=tied)
