"""Find meshes of domains: in the cache, by moving an earlier mesh with tumours that moved a little, or by meshing.

Memory and time of a solution are estimated before meshing. Measured on meshes of 40 000 to 250 000 tetrahedra, half and whole: a
tetrahedron has 4.1 unknowns; a factor in nested dissection has 22 n^(4/3) entries and takes 22 n^2 operations, n the unknowns,
within a tenth.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial

from geometry.common.cached_arrays import find_cache_folder
from geometry.common.resources import check_memory, check_time
from geometry.tetra.body_layout import BodyLayout
from geometry.tetra.cache import compute_key, read_or_make_mesh
from geometry.tetra.layout import build_layout, find_extent
from geometry.tetra.mesher import estimate_elements
from geometry.tetra.sizing import TetraFineness
from geometry.tetra.tet_mesh import TetMesh
from solver.linalg.conjugate_gradients import OPERATIONS_PER_SECOND, estimate_held_bytes
from solver.linalg.workspace import get_workspace
from solver.solid.domain import Domain
from solver.solid.moved_mesh import may_move, move_mesh, remove_movable_sizes

UNKNOWNS_PER_TETRAHEDRON = 4.1  # measured, see above
FACTOR_ENTRIES_COEFFICIENT = 22.0  # of the factor, over n^(4/3)
FACTOR_OPERATIONS_COEFFICIENT = 22.0  # over n^2
BYTES_PER_FACTOR_ENTRY = 1.4 * 4  # 4 bytes in single precision, times 1.4 for working memory


@dataclass
class LatestMesh:
    """The last mesh made for domains that differ in tumours and tissue sizes alone: the start of moved meshes.

    Attributes
    ----------
    layout, mesh
        The layout and its mesh; None before the first. Moved meshes are never stored here.
    """

    layout: BodyLayout | None = None
    mesh: TetMesh | None = None


def mesh_domain(domain: Domain, fineness: TetraFineness) -> TetMesh:
    """Return the domain's mesh, from the cache if possible.

    Raises
    ------
    InputError, Refusal, SolveError
        See ``geometry.tetra.cache.read_or_make_mesh``.
    """
    layout = build_domain_layout(domain)
    mesh = read_or_make_mesh(domain.scene, fineness, domain.half, None, domain.radius)
    latest = _find_latest_mesh(layout, fineness)
    latest.layout, latest.mesh = layout, mesh
    return mesh


def move_meshes(domain: Domain, finenesses: Iterable[TetraFineness]) -> list[TetMesh] | None:
    """Return the domain's meshes of several finenesses, moved from the last ones of nearly the same domain.

    None if one of them cannot be moved, or is in the cache of mesh files, from which it is read.
    """
    layout, meshes = build_domain_layout(domain), list[TetMesh]()
    for fineness in finenesses:
        latest = _find_latest_mesh(layout, fineness)
        if latest.mesh is None or latest.layout is None or is_meshed(domain, fineness) or not may_move(latest.layout, layout):
            return None
        mesh = get_workspace().keep(
            (TetMesh, compute_key(layout, fineness)), partial(move_mesh, latest.mesh, latest.layout, layout, fineness)
        )
        if mesh is None:
            return None
        meshes.append(mesh)
    return meshes


def _find_latest_mesh(layout: BodyLayout, fineness: TetraFineness) -> LatestMesh:
    """Return the workspace's record of the last mesh for layouts that differ from this one only in what may move."""
    return get_workspace().keep(
        (LatestMesh, f"{compute_key(remove_movable_sizes(layout), fineness)} {len(layout.inclusions)}"), LatestMesh
    )


def is_meshed(domain: Domain, fineness: TetraFineness) -> bool:
    """Return whether the cache has a mesh of the domain."""
    return (find_cache_folder("meshes") / f"{compute_key(build_domain_layout(domain), fineness)}.mesh").exists()


def build_domain_layout(domain: Domain) -> BodyLayout:
    """Return the layout of the bodies of a domain: the shapes and places that the mesher needs."""
    return build_layout(domain.scene, domain.half, find_extent(domain.scene, None), domain.radius)


def check_mesh(domain: Domain, fineness: TetraFineness) -> None:
    """Raise ``LimitReached`` if the equations of a mesh would exceed the limits of memory or time, before it is made.

    Raises
    ------
    LimitReached
        A limit would be exceeded.
    InputError, Refusal
        See ``geometry.tetra.layout.build_layout``.
    """
    check_unknowns(UNKNOWNS_PER_TETRAHEDRON * estimate_elements(build_domain_layout(domain), fineness))


def check_unknowns(n: float) -> None:
    """Raise ``LimitReached`` if solving for n unknowns would exceed the limits of memory or time."""
    check_memory(
        f"equations of some {n:.2g} unknowns",
        estimate_held_bytes(n, BYTES_PER_FACTOR_ENTRY * FACTOR_ENTRIES_COEFFICIENT * n ** (4 / 3)),
    )
    check_time(f"solving equations of some {n:.2g} unknowns", FACTOR_OPERATIONS_COEFFICIENT * n**2 / OPERATIONS_PER_SECOND)
