"""Flat tetrahedra at the bodies' outsides, which pytetwild leaves where a polygon is coarse: given to what is outside."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points
from geometry.tetra.labels import AIR
from geometry.tetra.smoothing import mean_ratios
from geometry.tetra.snapping import Surface, interfaces, memberships, snap, surfaces_of

Indices = NDArray[np.int64]
_FLAT = 0.1  # mean ratio of a tetrahedron that is given away
_ROUNDS = 3


def remove_slivers(
    surfaces: list[Surface], points: Points, tetrahedra: Indices, *, body: Indices, faces: Indices, chosen: Indices
) -> tuple[Indices, Indices, Indices]:
    """Bodies (t,), interface faces (f, 3) and their surfaces (f,) once flat tetrahedra with two or three outer faces are outside.

    Only such whose four corners are on one surface: that surface then goes along their other faces.
    """
    for _ in range(_ROUNDS):
        member = memberships(len(points), faces, chosen, len(surfaces))
        shared = np.logical_and.reduce(member[tetrahedra], axis=1)  # (t, surfaces)
        rows = np.flatnonzero((body >= 0) & np.logical_or.reduce(shared, axis=1))
        exact = snap(surfaces, points, member)
        flat = rows[mean_ratios(exact, tetrahedra[rows]) < _FLAT]
        slivers = flat[_faces_outside(tetrahedra, body, flat) >= 2]
        if len(slivers) == 0:
            break
        body = body.copy()
        body[slivers] = AIR
        faces, one, other = interfaces(tetrahedra, body)
        on_bodies = np.maximum(one, other) >= 0
        faces = faces[on_bodies]
        chosen = surfaces_of(surfaces, points, faces, one[on_bodies], other[on_bodies])
    return body, faces, chosen


def _faces_outside(tetrahedra: Indices, body: Indices, rows: Indices) -> Indices:
    """How many faces of each of the tetrahedra ``rows`` are outer ones, (r,)."""
    near = np.flatnonzero(np.isin(tetrahedra, tetrahedra[rows]).sum(axis=1) >= 3)
    faces, one, other = interfaces(tetrahedra[near], body[near])
    faces = np.sort(faces[(np.minimum(one, other) < 0) & (np.maximum(one, other) >= 0)], axis=1)
    outside = {tuple(face) for face in faces.tolist()}
    triples = [(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)]
    ordered = np.sort(tetrahedra[rows], axis=1).tolist()
    return np.array([sum(tuple(t[k] for k in triple) in outside for triple in triples) for t in ordered], dtype=np.int64)
