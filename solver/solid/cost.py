"""Estimate memory and time of a solution on tetrahedra before meshing.

Measured on meshes of 40 000 to 250 000 tetrahedra, half and whole: a tetrahedron has 4.1 unknowns; a
factor in nested dissection has 22 n^(4/3) entries and takes 22 n^2 operations, n the unknowns, within a tenth.
"""

from __future__ import annotations

from geometry.common.resources import check_memory, check_time
from geometry.tetra.layout import build_layout, find_extent
from geometry.tetra.mesher import estimate_elements
from geometry.tetra.sizing import TetraFineness
from solver.linalg.conjugate_gradients import OPERATIONS_PER_SECOND, estimate_held_bytes
from solver.solid.domain import Domain

UNKNOWNS_PER_TETRAHEDRON = 4.1  # measured, see above
FACTOR_ENTRIES_COEFFICIENT = 22.0  # of the factor, over n^(4/3)
FACTOR_OPERATIONS_COEFFICIENT = 22.0  # over n^2
BYTES_PER_FACTOR_ENTRY = 1.4 * 4  # 4 bytes in single precision, times 1.4 for working memory


def check_mesh(domain: Domain, fineness: TetraFineness) -> None:
    """Refuse a mesh whose equations would exceed the limits of memory or time.

    Raises
    ------
    LimitReached
        A limit would be exceeded.
    InputError, Refusal
        See ``geometry.tetra.layout.build_layout``.
    """
    layout = build_layout(domain.scene, domain.half, find_extent(domain.scene, None), domain.radius)
    check_unknowns(UNKNOWNS_PER_TETRAHEDRON * estimate_elements(layout, fineness))


def check_unknowns(n: float) -> None:
    """Refuse n unknowns that would exceed the limits of memory or time; see ``check_mesh``."""
    check_memory(
        f"equations of some {n:.2g} unknowns",
        estimate_held_bytes(n, BYTES_PER_FACTOR_ENTRY * FACTOR_ENTRIES_COEFFICIENT * n ** (4 / 3)),
    )
    check_time(f"solving equations of some {n:.2g} unknowns", FACTOR_OPERATIONS_COEFFICIENT * n**2 / OPERATIONS_PER_SECOND)
