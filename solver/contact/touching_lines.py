"""Which lines of a section may touch which."""

from __future__ import annotations

import numpy as np

from geometry.meridian.mesh import SQUARE, Topology, nodes
from geometry.meridian.section import Body, Section
from solver.axisymmetric.base_states import Materials
from solver.contact.curves import walls
from solver.contact.pairs import FALLING, LEVEL, RISING, Pair

NARROW = 0.02  # of the outer radius: a wider gap says nothing of how exact contact has to be
STIFF = 1000.0  # penalty: moduli of the softer body per length of its elements at the line


def contact_length(section: Section) -> float:
    """What penetration and rounding are told in, m: the gap, or a share of the probe."""
    return min(float(section.hole_radius - section.inner_radius), NARROW * float(section.tube_radius))


def pairs_of(section: Section, materials: Materials, mesh: Topology, order: int) -> tuple[Pair, ...]:
    """Return the walls of the gap, first, and each wall with the tissue beside it, the outermost last."""
    lines = walls(mesh, nodes(section, mesh, SQUARE), order)
    lines["strip from outside"] = lines["strip"].reversed()
    plan = (
        ("walls of the gap", "inner wall", "hole wall", LEVEL),
        ("inner wall and strip", "strip", "inner wall", RISING),
        ("hole wall and strip", "strip from outside", "hole wall", FALLING),
        ("tube wall and tissue", "top", "tube wall", RISING),
    )
    pairs = []
    for name, below, above, axes in plan:  # the gap is s of the second less that of the first
        soft, hard = (materials[Body(mesh.body[lines[line].element[0]])].youngs_modulus for line in (below, above))
        swapped = hard < soft
        slave, master = (above, below) if swapped else (below, above)
        place = lines[slave].place
        size = float(np.linalg.norm(place[:, :, 1] - place[:, :, 0], axis=1).min())
        pairs.append(
            Pair(name, lines[slave], lines[master], np.array(axes), -1.0 if swapped else 1.0, STIFF * min(soft, hard) / size)
        )
    return tuple(pairs)
