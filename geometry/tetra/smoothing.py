"""Improve bad tetrahedra: move their corners to where all adjacent tetrahedra are better, along the surfaces they lie on.

Flat ones at the bodies' outsides, which pytetwild leaves where a polygon is coarse, are assigned to the outside.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from geometry.common.arrays import Points
from geometry.tetra.snapping import Surface, find_interfaces, find_memberships, find_surface_faces, snap
from geometry.tetra.tet_mesh import MeshBody

Indices = NDArray[np.int64]
_REGULAR_INVERSE = np.linalg.inv(np.array([[1, 0.5, 0.5], [0, 3**0.5 / 2, 3**0.5 / 6], [0, 0, (2 / 3) ** 0.5]]))
_ENERGY_POWER = 2  # the larger, the more the worst tetrahedron counts
_MAX_RETREATS = 6
_MAX_MINIMISER_STEPS = 40  # of the minimiser, between two returns to the surfaces
_SLIVER_RATIO = 0.1  # mean ratio of a tetrahedron that is given away
_MAX_SLIVER_ROUNDS = 3


def compute_mean_ratios(points: Points, tetrahedra: Indices) -> Points:
    """Return mean ratios of straight tetrahedra, (t,): 1 for a regular one, 0 for a flat one, negative for an inverted one."""
    t = _compute_maps(points[tetrahedra])
    det = np.linalg.det(t)
    result: Points = 3 * np.cbrt(det) ** 2 * np.sign(det) / np.maximum((t**2).sum(axis=(1, 2)), 1e-300)
    return result


def smooth(
    points: Points, tetrahedra: Indices, surfaces: list[Surface], member: NDArray[np.bool_], *, min_ratio: float, rounds: int
) -> Points:
    """Return points (n, 3) moved until no tetrahedron has a mean ratio below ``min_ratio``, at most ``rounds`` times.

    Only the corners of bad tetrahedra and of those that touch them move, along the surfaces that they are members of.
    ``member`` (n, surfaces) says which these are.
    """
    result = points
    for _ in range(rounds):
        quality = compute_mean_ratios(result, tetrahedra)
        bad = quality < min_ratio
        if not bad.any():
            break
        is_moving = np.zeros(len(points), dtype=bool)
        is_moving[tetrahedra[bad]] = True
        is_moving[tetrahedra[is_moving[tetrahedra].any(axis=1)]] = True  # and the corners of all that touch them
        patch = tetrahedra[is_moving[tetrahedra].any(axis=1)]
        trial = snap(surfaces, _minimise(result, patch, np.flatnonzero(is_moving), surfaces, member), member)
        before, after = (_average_worst_quality(compute_mean_ratios(nodes, patch)) for nodes in (result, trial))
        if after <= before:
            break
        result = trial
    return result


def undo_inversions(points: Points, original: Points, tetrahedra: Indices, min_ratio: float | Points) -> Points:
    """Return points (n, 3), the corners of bad tetrahedra put back to their ``original`` places.

    Bad are mean ratios below ``min_ratio``, one number or one for each tetrahedron (t,). All tetrahedra were good at the original
    places; a neighbour that becomes bad when corners are put back is put back in the next round, and is good again in the end.
    """
    result = points.copy()
    for _ in range(_MAX_RETREATS):
        bad = compute_mean_ratios(result, tetrahedra) < min_ratio
        if not bad.any():
            break
        restored = np.unique(tetrahedra[bad])
        result[restored] = original[restored]
    return result


def _average_worst_quality(quality: Points) -> float:
    """Return the mean of the twenty worst qualities; a round of smoothing is accepted if it raises this."""
    return float(np.sort(quality)[:20].mean())


def _minimise(points: Points, patch: Indices, rows: Indices, surfaces: list[Surface], member: NDArray[np.bool_]) -> Points:
    """Return points (n, 3), those in ``rows`` moved along their surfaces' tangents to the minimum energy of ``patch`` (t, 4)."""
    tangent = _compute_tangents(points[rows], surfaces, member[rows])
    # unknowns of about 1: displacements over a typical edge length
    scale = float(np.median(np.linalg.norm(points[patch[:, 1]] - points[patch[:, 0]], axis=1)))

    def compute_energy(flat: Points) -> tuple[float, Points]:
        moved = points.copy()
        moved[rows] += scale * np.einsum("nij,nj->ni", tangent, flat.reshape(-1, 3))
        value, derivative = _compute_energies(moved[patch])
        total = np.zeros_like(points)
        np.add.at(total, patch.ravel(), derivative.reshape(-1, 3))
        return float(value.sum()), scale * np.einsum("nij,nj->ni", tangent, total[rows]).ravel()

    best = minimize(
        compute_energy,
        np.zeros(3 * len(rows)),
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": _MAX_MINIMISER_STEPS, "maxfun": 2 * _MAX_MINIMISER_STEPS},
    )
    result = points.copy()
    result[rows] += scale * np.einsum("nij,nj->ni", tangent, best.x.reshape(-1, 3))
    return result


def _compute_tangents(points: Points, surfaces: list[Surface], member: NDArray[np.bool_]) -> Points:
    """Return the projections (n, 3, 3) onto the directions tangent to all surfaces that points (n, 3) lie on.

    With the surfaces' normals as the rows of N, a projection is I - pinv(N) N; without a surface it is I.
    """
    result = np.broadcast_to(np.eye(3), (len(points), 3, 3)).copy()
    rows = np.flatnonzero(member.any(axis=1))
    derivatives = np.zeros((len(rows), len(surfaces), 3))
    for index, surface in enumerate(surfaces):
        is_member = np.flatnonzero(member[rows, index])
        if len(is_member):
            derivatives[is_member, index] = surface.level(points[rows[is_member]])[1]
    result[rows] -= np.linalg.pinv(derivatives, rcond=1e-3) @ derivatives
    return result


def _compute_maps(corners: Points) -> Points:
    """Return the linear maps (t, 3, 3) from a regular tetrahedron of edge 1 to those with ``corners`` (t, 4, 3)."""
    result: Points = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2) @ _REGULAR_INVERSE
    return result


def _compute_energies(corners: Points) -> tuple[Points, Points]:
    """Return the distortion energy (|T|^2 / 3 / det(T)^(2/3))^(3 p / 2) of each tetrahedron, (t,), and its gradients (t, 4, 3).

    T is the linear map from a regular tetrahedron, p is ``_ENERGY_POWER``. det(T) is smoothed, so that inverted tetrahedra have
    finite energies.
    """
    t = _compute_maps(corners)
    size = np.cbrt(np.abs(np.linalg.det(t))) + 1e-2 * np.sqrt((t**2).sum(axis=(1, 2)))
    # the smoothed det(T) is (det + sqrt(det^2 + floor^2)) / 2: nearly det where that is positive, small but positive elsewhere
    det, floor = np.linalg.det(t), 3e-2 * size**3
    root = np.sqrt(det**2 + floor**2)
    volume = (det + root) / 2
    square = (t**2).sum(axis=(1, 2)) / 3
    value = (square**1.5 / volume) ** _ENERGY_POWER
    cofactor = np.cross(t[:, [1, 2, 0]], t[:, [2, 0, 1]])  # the derivative of det(T) with respect to T
    map_derivative = (
        value[:, None, None] * _ENERGY_POWER * (t / square[:, None, None] - (volume / root / volume)[:, None, None] * cofactor)
    )
    derivative = np.swapaxes(map_derivative @ _REGULAR_INVERSE.T, 1, 2)
    # the first corner moves all three edges of the map the other way
    return value, np.concatenate([-derivative.sum(axis=1, keepdims=True), derivative], axis=1)


def remove_slivers(
    surfaces: list[Surface], points: Points, tetrahedra: Indices, *, body: Indices, faces: Indices, chosen: Indices
) -> tuple[Indices, Indices, Indices]:
    """Remove flat tetrahedra with two or three outer faces; return bodies (t,), interface faces (f, 3), surfaces (f,).

    They are labelled as outside. Only those whose four corners are on one surface are removed: that surface then follows their
    other faces. ``body`` (t,), ``faces`` and ``chosen`` (each face's surface) are these before the removal.
    """
    for _ in range(_MAX_SLIVER_ROUNDS):
        member = find_memberships(len(points), faces, chosen, len(surfaces))
        shared = np.logical_and.reduce(member[tetrahedra], axis=1)  # (t, surfaces)
        rows = np.flatnonzero((body >= 0) & np.logical_or.reduce(shared, axis=1))
        exact = snap(surfaces, points, member)
        flat = rows[compute_mean_ratios(exact, tetrahedra[rows]) < _SLIVER_RATIO]
        slivers = flat[_count_outer_faces(tetrahedra, body, flat) >= 2]
        if len(slivers) == 0:
            break
        body = body.copy()
        body[slivers] = MeshBody.AIR
        faces, chosen = find_surface_faces(surfaces, points, tetrahedra, body)
    return body, faces, chosen


def _count_outer_faces(tetrahedra: Indices, body: Indices, rows: Indices) -> Indices:
    """Return how many faces of each of the tetrahedra ``rows`` lie between a body and the outside, (r,)."""
    # all that share three corners with one of these: enough to find what lies on the other side of each face
    neighbours = np.flatnonzero(np.isin(tetrahedra, tetrahedra[rows]).sum(axis=1) >= 3)
    faces, first_body, second_body = find_interfaces(tetrahedra[neighbours], body[neighbours])
    faces = np.sort(faces[(np.minimum(first_body, second_body) < 0) & (np.maximum(first_body, second_body) >= 0)], axis=1)
    outside = {tuple(face) for face in faces.tolist()}
    triples = [(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)]
    ordered = np.sort(tetrahedra[rows], axis=1).tolist()
    return np.array([sum(tuple(t[k] for k in triple) in outside for triple in triples) for t in ordered], dtype=np.int64)
