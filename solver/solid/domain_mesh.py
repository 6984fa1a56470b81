"""Meshes of domains, and whether they are there."""

from __future__ import annotations

from geometry.tetra.cache import cached_mesh, folder, key
from geometry.tetra.layout import body_layout, extent
from geometry.tetra.sizing import TetraFineness
from geometry.tetra.tet_mesh import TetMesh
from solver.solid.domain import Domain


def mesh_domain(domain: Domain, fineness: TetraFineness) -> TetMesh:
    """Return the domain's mesh, from the cache if it was made before.

    Raises:
        InputError, Refusal, SolveError: see ``geometry.tetra.cache.cached_mesh``.
    """
    return cached_mesh(domain.scene, fineness, domain.half, None, domain.radius)


def is_meshed(domain: Domain, fineness: TetraFineness) -> bool:
    """Whether the cache has a mesh of the domain."""
    layout = body_layout(domain.scene, domain.half, extent(domain.scene, None), domain.radius)
    return (folder() / f"{key(layout, fineness)}.mesh").exists()
