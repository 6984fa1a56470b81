"""Move the nodes of a mesh, corners and middles of edges, onto the exact surfaces that they represent.

Every exact surface is a function that is zero on it; a node on an edge or in a corner is on several, and goes to where all
of them are zero by Newton's method, along the shortest path.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points
from geometry.common.errors import SolveError
from geometry.tetra.body_layout import BodyLayout
from geometry.tetra.tet_mesh import EDGE_CORNERS, FACE_CORNERS, MeshBody, build_quadratic, compute_scaled_jacobians, match_faces

Indices = NDArray[np.int64]
Level = Callable[[Points], tuple[Points, Points]]  # approximate distances (n,) of points (n, 3), and their gradients (n, 3)
_NEWTON_STEPS = 6
_MIN_JACOBIAN = 0.03  # scaled Jacobian below which no element that was above it may fall
_BEND_FRACTIONS = (0.8, 0.7, 0.6, 0.5, 0.0, 0.0, 0.0)  # of its bend that an edge of a bad element keeps, step by step
_OTHER_BEND_FRACTIONS = (0.8,) * 5  # the same where an element has an edge between two faces on surfaces, of its other edges


@dataclass(frozen=True)
class Surface:
    """An exact surface.

    Attributes
    ----------
    level
        Function that is zero on it, with its gradient.
    separates
        Function that returns between which pairs of bodies (n,), (n,) it can lie, in this order; air is what is outside.
    permanent
        Whether its nodes stay on it even where an element had to be put back to its place before snapping.
    """

    level: Level
    separates: Callable[[Indices, Indices], NDArray[np.bool_]]
    permanent: bool = False


def build_exact_surfaces(layout: BodyLayout) -> list[Surface]:
    """Return all exact surfaces of a scene, the planes between layers last; these separate no bodies, see ``layers.py``."""
    air = MeshBody.AIR
    result = [
        Surface(_build_cylinder(layout.inner), _separates_sets([MeshBody.INNER], [air])),
        Surface(_build_plane((0, 0, 1), layout.inner_height), _separates_sets([MeshBody.INNER], [air]), True),
        Surface(_build_cylinder(layout.hole), _separates_sets([MeshBody.OUTER, MeshBody.GROOVE], [air])),
        Surface(_build_cylinder(layout.tube), _separates_sets([MeshBody.OUTER, MeshBody.GROOVE], [air])),
        Surface(_build_plane((0, 0, 1), layout.outer_height), _separates_sets([MeshBody.OUTER, MeshBody.GROOVE], [air]), True),
        Surface(
            _build_plane((0, 0, 1), 0.0),
            _separates_sets([MeshBody.TISSUE, MeshBody.BEYOND], [air, MeshBody.INNER, MeshBody.OUTER]),
            True,
        ),
        Surface(_build_plane((0, 0, 1), -layout.depth), _separates_sets([MeshBody.TISSUE, MeshBody.BEYOND], [air]), True),
    ]
    if layout.groove is not None:
        width, depth = layout.groove
        planes = [((0, 1, 0), width), ((0, 1, 0), -width), ((0, 0, 1), layout.outer_height - depth)]
        result += [
            Surface(_build_plane(direction, position), _separates_sets([MeshBody.OUTER], [MeshBody.GROOVE]))
            for direction, position in planes
        ]
    result += [
        Surface(side, _separates_sets([MeshBody.TISSUE, MeshBody.BEYOND], [air]), layout.tissue_radius is None)
        for side in _list_sides(layout)
    ]
    if layout.wall is not None:
        result.append(Surface(_build_cylinder(layout.wall), _separates_exactly(MeshBody.TISSUE, MeshBody.BEYOND)))
    for index, body in enumerate(layout.inclusions):
        result.append(Surface(body.find_level, _separates_body(MeshBody.FIRST_INCLUSION + index)))
    result.append(Surface(_build_plane((0, 1, 0), 0.0), _separates_body(MeshBody.MIRROR), True))
    return [*result, *(Surface(_build_plane((0, 0, 1), -depth), _separates_none, True) for depth in layout.interfaces)]


def find_interfaces(tetrahedra: Indices, body: Indices) -> tuple[Indices, Indices, Indices]:
    """Return the faces between different bodies: corners (f, 3) and the bodies (f,) on both sides.

    ``MeshBody.AIR`` outside the mesh.
    """
    faces, (first, second), alone = match_faces(tetrahedra)
    chosen = np.concatenate([first, alone])
    first_body = body[chosen // 4]  # each tetrahedron has four faces
    second_body = np.concatenate([body[second // 4], np.full(len(alone), MeshBody.AIR)])
    differ = first_body != second_body
    return faces[chosen[differ]], first_body[differ], second_body[differ]


def find_surfaces(surfaces: list[Surface], points: Points, faces: Indices, first_body: Indices, second_body: Indices) -> Indices:
    """Return the index of each face's surface, (f,): of those between its two bodies the nearest in place and direction.

    Raises
    ------
    SolveError
        Two bodies share a face, and no surface of the scene lies between them.
    """
    corners = points[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.sqrt(np.linalg.norm(normal, axis=1)) + 1e-300
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    best, chosen = np.full(len(faces), np.inf), np.full(len(faces), -1)
    for index, surface in enumerate(surfaces):
        rows = np.flatnonzero(surface.separates(first_body, second_body) | surface.separates(second_body, first_body))
        if len(rows) == 0:
            continue
        distance = np.abs(np.stack([surface.level(corners[rows, k])[0] for k in range(3)])).max(axis=0)
        derivative = surface.level(corners[rows].mean(axis=1))[1]
        misalignment = 1 - np.abs(np.einsum("ij,ij->i", derivative, normal[rows]))
        # both as lengths: the farthest corner's distance, and half the face's size where it is at right angles to the surface
        cost = distance + 0.5 * misalignment * size[rows]
        better = cost < best[rows]
        best[rows[better]], chosen[rows[better]] = cost[better], index
    if (chosen < 0).any():
        a, b = first_body[chosen < 0][0], second_body[chosen < 0][0]
        raise SolveError(f"volume mesh: bodies {a} and {b} touch, which they do not in the scene")
    return chosen


def find_surface_faces(surfaces: list[Surface], points: Points, tetrahedra: Indices, body: Indices) -> tuple[Indices, Indices]:
    """Return the faces (f, 3) between bodies, or between a body and the outside, and the indices (f,) of their surfaces."""
    faces, first_body, second_body = find_interfaces(tetrahedra, body)
    on_bodies = np.maximum(first_body, second_body) >= 0
    faces = faces[on_bodies]
    return faces, find_surfaces(surfaces, points, faces, first_body[on_bodies], second_body[on_bodies])


def find_memberships(count: int, faces: Indices, chosen: Indices, surfaces: int) -> NDArray[np.bool_]:
    """Return which of ``surfaces`` (a number) each of ``count`` nodes lies on: those ``chosen`` (f,) by its faces (f, 3)."""
    member = np.zeros((count, surfaces), dtype=bool)
    for k in range(3):
        member[faces[:, k], chosen] = True
    return member


def snap(surfaces: list[Surface], points: Points, member: NDArray[np.bool_]) -> Points:
    """Move points (n, 3) onto all surfaces that each is a member of, (n, surfaces)."""
    result = points.copy()
    single = member.sum(axis=1)
    for _ in range(_NEWTON_STEPS):
        for index, surface in enumerate(surfaces):
            rows = np.flatnonzero(member[:, index] & (single == 1))
            if len(rows):
                level, derivative = surface.level(result[rows])
                result[rows] -= level[:, None] * derivative
        _step_to_edges(surfaces, result, member, np.flatnonzero(single > 1))
    return result


def snap_to_permanent(surfaces: list[Surface], points: Points, member: NDArray[np.bool_]) -> Points:
    """Move points (n, 3) onto only the permanent ones of the surfaces that each is a member of, (n, surfaces)."""
    return snap(surfaces, points, member & np.array([surface.permanent for surface in surfaces]))


def curve_mesh(
    corners: Points, tetrahedra: Indices, surfaces: list[Surface], *, faces: Indices, chosen: Indices, keep: float
) -> tuple[Points, Indices]:
    """Return nodes and elements of quadratic mesh whose interface edges follow the surfaces ``chosen`` (f,) of ``faces`` (f, 3).

    Edges of elements whose scaled Jacobian would fall below ``keep`` times the straight element's are straightened, step by step.
    Two faces that an element has on one surface are tangent to each other along their common edge once all is curved. So its
    other edges are straightened first, until that edge stands out between them.
    """
    nodes, elements, pairs = build_quadratic(corners, tetrahedra)
    straight, count = nodes.copy(), len(corners)
    member = _find_edge_members(pairs, faces, chosen, len(surfaces), count)
    nodes[count:] = snap(surfaces, nodes[count:], member)
    bent = elements[np.flatnonzero(member[elements[:, 4:] - count].any(axis=(1, 2)))]
    straight_jacobians = compute_scaled_jacobians(straight, bent)
    min_jacobians = np.maximum(keep * straight_jacobians, np.minimum(0.9 * straight_jacobians, _MIN_JACOBIAN))
    is_between, all_edges = _find_edges_between_faces(bent, faces), np.ones((len(bent), 6), dtype=bool)
    is_other = is_between.any(axis=1, keepdims=True) & ~is_between
    for share, edge_mask in [
        *((share, is_other) for share in _OTHER_BEND_FRACTIONS),
        *((share, all_edges) for share in _BEND_FRACTIONS),
    ]:
        bad = compute_scaled_jacobians(nodes, bent) < min_jacobians
        if not bad.any():
            break
        middles = np.unique(bent[:, 4:][edge_mask & bad[:, None]])
        nodes[middles] = straight[middles] + share * (nodes[middles] - straight[middles])
    return nodes, elements


def _find_edges_between_faces(elements: Indices, faces: Indices) -> NDArray[np.bool_]:
    """Return which of the six edges of elements (t, 10) are common to two of their faces among ``faces`` (f, 3), (t, 6)."""
    # a face is known by one number: its sorted corners as digits to a base above all of them
    base = int(elements[:, :4].max(initial=faces.max(initial=0))) + 1
    element_keys, given = (np.sort(part, axis=-1) @ np.array([base**2, base, 1]) for part in (elements[:, FACE_CORNERS], faces))
    is_given = np.isin(element_keys, given)
    edge_in_face = (EDGE_CORNERS[:, None, :, None] == FACE_CORNERS[None, :, None, :]).any(axis=3).all(axis=2)  # edges, faces
    return np.asarray(is_given.astype(int) @ edge_in_face.T.astype(int) == 2)


def _find_edge_members(pairs: Indices, faces: Indices, chosen: Indices, surfaces: int, count: int) -> NDArray[np.bool_]:
    """Return which surfaces each edge, ``pairs`` (m, 2), lies on, (m, surfaces): those of the faces that it bounds.

    ``surfaces`` is their number, ``count`` that of the corners.
    """
    edges = np.sort(faces[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=1)
    keys = pairs[:, 0] * count + pairs[:, 1]  # the pairs are in order, so their keys are
    edge_keys = edges[:, 0] * count + edges[:, 1]
    index = np.clip(np.searchsorted(keys, edge_keys), 0, len(keys) - 1)
    hit = keys[index] == edge_keys
    member = np.zeros((len(pairs), surfaces), dtype=bool)
    member[index[hit], np.repeat(chosen, 3)[hit]] = True
    return member


def _step_to_edges(surfaces: list[Surface], points: Points, member: NDArray[np.bool_], rows: Indices) -> None:
    """Make one step of Newton's method for the points ``rows``, which lie on several surfaces."""
    if len(rows) == 0:
        return
    # the shortest step that makes all levels zero to first order: by the pseudo-inverse of their gradients; ``rcond`` leaves out
    # surfaces that touch each other, whose gradients are nearly the same
    used = np.flatnonzero(member[rows].any(axis=0))
    levels, derivatives = np.zeros((len(rows), len(used))), np.zeros((len(rows), len(used), 3))
    for k, index in enumerate(used):
        is_member = member[rows, index]
        levels[is_member, k], derivatives[is_member, k] = surfaces[index].level(points[rows[is_member]])
    points[rows] -= np.einsum("nak,nk->na", np.linalg.pinv(derivatives, rcond=1e-3), levels)


def _separates_sets(first: list[int], second: list[int]) -> Callable[[Indices, Indices], NDArray[np.bool_]]:
    """Return a test for faces between a body of ``first`` and one of ``second``."""
    return lambda a, b: np.isin(a, first) & np.isin(b, second)


def _separates_exactly(first: int, second: int) -> Callable[[Indices, Indices], NDArray[np.bool_]]:
    """Return a test for faces between the bodies ``first`` and ``second``."""
    return lambda a, b: (a == first) & (b == second)


def _separates_body(body: int) -> Callable[[Indices, Indices], NDArray[np.bool_]]:
    """Return a test for faces between ``body`` and any other body, except the plane of symmetry."""
    return lambda a, b: (a == body) & ((b != MeshBody.MIRROR) if body != MeshBody.MIRROR else (b >= 0))


def _separates_none(a: Indices, b: Indices) -> NDArray[np.bool_]:
    """Return False for all faces: the test of a plane between layers, which lies inside one body."""
    return np.zeros(len(a), dtype=bool)


def _build_plane(direction: tuple[float, float, float], position: float) -> Level:
    """Return the level of a plane with the unit normal ``direction``, at a distance ``position`` from the origin, m."""
    normal = np.array(direction, dtype=float)
    return lambda points: (points @ normal - position, np.broadcast_to(normal, points.shape))


def _build_cylinder(radius: float, centre: tuple[float, float] = (0.0, 0.0)) -> Level:
    """Return the level of a vertical cylinder whose axis passes through ``centre`` (x, y)."""

    def compute_level(points: Points) -> tuple[Points, Points]:
        offset = points * [1.0, 1.0, 0.0] - [*centre, 0.0]
        distance = np.hypot(offset[:, 0], offset[:, 1])
        return distance - radius, offset / np.maximum(distance, 1e-300)[:, None]

    return compute_level


def _list_sides(layout: BodyLayout) -> list[Level]:
    """Return the levels of the tissue's side: one cylinder, or the four planes of a block."""
    if layout.tissue_radius is not None:
        return [_build_cylinder(layout.tissue_radius, layout.centre)]
    (x, y), (a, b) = layout.centre, layout.sides
    return [
        _build_plane((1, 0, 0), x + a),
        _build_plane((1, 0, 0), x - a),
        _build_plane((0, 1, 0), y + b),
        _build_plane((0, 1, 0), y - b),
    ]
