"""Make meshes of domains, in the cache or anew, and estimate memory and time of a solution before meshing.

Measured on meshes of 40 000 to 250 000 tetrahedra, half and whole: a tetrahedron has 4.1 unknowns; a
factor in nested dissection has 22 n^(4/3) entries and takes 22 n^2 operations, n the unknowns, within a tenth.
"""

from __future__ import annotations

from geometry.common.resources import check_memory, check_time
from geometry.tetra.body_layout import BodyLayout
from geometry.tetra.cache import compute_key, find_cache_folder, read_or_make_mesh
from geometry.tetra.layout import build_layout, find_extent
from geometry.tetra.mesher import estimate_elements
from geometry.tetra.sizing import TetraFineness
from geometry.tetra.tet_mesh import TetMesh
from solver.linalg.conjugate_gradients import OPERATIONS_PER_SECOND, estimate_held_bytes
from solver.solid.domain import Domain

UNKNOWNS_PER_TETRAHEDRON = 4.1  # measured, see above
FACTOR_ENTRIES_COEFFICIENT = 22.0  # of the factor, over n^(4/3)
FACTOR_OPERATIONS_COEFFICIENT = 22.0  # over n^2
BYTES_PER_FACTOR_ENTRY = 1.4 * 4  # 4 bytes in single precision, times 1.4 for working memory


def mesh_domain(domain: Domain, fineness: TetraFineness) -> TetMesh:
    """Return the domain's mesh, from the cache if possible.

    Raises
    ------
    InputError, Refusal, SolveError
        See ``geometry.tetra.cache.read_or_make_mesh``.
    """
    return read_or_make_mesh(domain.scene, fineness, domain.half, None, domain.radius)


def build_domain_layout(domain: Domain) -> BodyLayout:
    """Return the layout of the bodies of a domain."""
    return build_layout(domain.scene, domain.half, find_extent(domain.scene, None), domain.radius)


def is_meshed(domain: Domain, fineness: TetraFineness) -> bool:
    """Return whether the cache has a mesh of the domain."""
    return (find_cache_folder() / f"{compute_key(build_domain_layout(domain), fineness)}.mesh").exists()


def check_cost(domain: Domain, fineness: TetraFineness) -> None:
    """Refuse a mesh whose equations would exceed the limits of memory or time.

    Raises
    ------
    LimitReached
        A limit would be exceeded.
    InputError, Refusal
        See ``geometry.tetra.layout.build_layout``.
    """
    if is_meshed(domain, fineness):
        count: float = len(mesh_domain(domain, fineness).elements)
    else:
        count = estimate_elements(build_domain_layout(domain), fineness)
    n = UNKNOWNS_PER_TETRAHEDRON * count
    check_memory(
        f"equations of some {n:.2g} unknowns",
        estimate_held_bytes(n, BYTES_PER_FACTOR_ENTRY * FACTOR_ENTRIES_COEFFICIENT * n ** (4 / 3)),
    )
    check_time(f"solving equations of some {n:.2g} unknowns", FACTOR_OPERATIONS_COEFFICIENT * n**2 / OPERATIONS_PER_SECOND)
