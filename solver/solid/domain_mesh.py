"""Find meshes of domains: in the cache, by moving an earlier mesh with tumours that moved a little, or by meshing."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial

from geometry.tetra.cache import cached_mesh, folder, key
from geometry.tetra.layout import BodyLayout, body_layout, extent
from geometry.tetra.sizing import TetraFineness
from geometry.tetra.tet_mesh import TetMesh
from solver.linalg.workspace import current
from solver.solid.domain import Domain
from solver.solid.moved_mesh import may_move, moved_mesh, unmoved


@dataclass
class LatestMesh:
    """The last mesh made for domains that differ in tumours and tissue sizes alone: the start of moved meshes.

    Attributes:
        layout, mesh: the layout and its mesh; None before the first. Moved meshes are never stored here.
    """

    layout: BodyLayout | None = None
    mesh: TetMesh | None = None


def mesh_domain(domain: Domain, fineness: TetraFineness) -> TetMesh:
    """Return the domain's mesh, from the cache if possible.

    Raises:
        InputError, Refusal, SolveError: see ``geometry.tetra.cache.cached_mesh``.
    """
    layout = _layout(domain)
    mesh = cached_mesh(domain.scene, fineness, domain.half, None, domain.radius)
    latest = _latest(layout, fineness)
    latest.layout, latest.mesh = layout, mesh
    return mesh


def moved_meshes(domain: Domain, finenesses: Iterable[TetraFineness]) -> list[TetMesh] | None:
    """Return meshes moved from those of nearly the same domain; None if one cannot be moved or is in the cache."""
    layout, found = _layout(domain), list[TetMesh]()
    for fineness in finenesses:
        latest = _latest(layout, fineness)
        if latest.mesh is None or latest.layout is None or is_meshed(domain, fineness) or not may_move(latest.layout, layout):
            return None
        mesh = current().keep((TetMesh, key(layout, fineness)), partial(moved_mesh, latest.mesh, latest.layout, layout, fineness))
        if mesh is None:
            return None
        found.append(mesh)
    return found


def _latest(layout: BodyLayout, fineness: TetraFineness) -> LatestMesh:
    """Return the workspace's record of the last mesh for layouts of this kind."""
    return current().keep((LatestMesh, f"{key(unmoved(layout), fineness)} {len(layout.inclusions)}"), LatestMesh)


def is_meshed(domain: Domain, fineness: TetraFineness) -> bool:
    """Return whether the cache has a mesh of the domain."""
    return (folder() / f"{key(_layout(domain), fineness)}.mesh").exists()


def _layout(domain: Domain) -> BodyLayout:
    """Return the layout of the bodies of a domain."""
    return body_layout(domain.scene, domain.half, extent(domain.scene, None), domain.radius)
