"""Extract the faces of a tetrahedral mesh that a picture shows: its skin, and its section at y = 0."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.tetra.tet_mesh import BEYOND, FACE_MIDDLES, FACES, GROOVE, INCLUSION, INNER, OUTER, TISSUE
from solver.solid.base_states import SolidFields, at_nodes
from solver.solid.problem import AT, Problem
from solver.solid.regions import Region

NAMES = {INNER: "inner", OUTER: "outer", GROOVE: "groove", TISSUE: "tissue", BEYOND: "tissue beyond"}
SPLIT = np.array([(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)])  # a quadratic triangle as four flat ones
RIM = np.array([(0, 3), (3, 1), (1, 4), (4, 2), (2, 5), (5, 0)])  # the sides of its six-node triangle, as pairs
EIGHT = np.array([(0, 4, 6, 7), (4, 1, 5, 8), (6, 5, 2, 9), (7, 8, 9, 3), (6, 8, 4, 5), (6, 8, 5, 9), (6, 8, 9, 7), (6, 8, 7, 4)])
ASIDE = 3.3e-6  # offset of the section from y = 0 over the size of the mesh, so that it meets no node
_AROUND = np.hstack([FACES, FACE_MIDDLES])


@dataclass(frozen=True)
class Faces:
    """Flat triangles, the lines of the mesh on them, and fields at their points.

    Attributes:
        points: in m, shape (n, 3).
        triangles: of these points, shape (f, 3).
        body: of each triangle, as in ``Solid.body``, shape (f,).
        lines: sides of elements, pairs of points, shape (m, 2).
        values: fields at the points by name: ``displacement`` in m (n, 3), ``pressure`` and ``von_mises`` in Pa (n,).
    """

    points: Floats
    triangles: Ints
    body: Ints
    lines: Ints
    values: Mapping[str, Floats] = field(default_factory=dict)


def name(number: int) -> str:
    """Return the name of a region, such as ``tissue.layer[k]``, ``inclusion[i] in tissue.layer[k]``, ``inclusion[i] beyond``."""
    body, layer, outside = Region.of(number)
    whole, within = NAMES.get(body) or f"inclusion[{body - INCLUSION}]", f"tissue.layer[{layer - 1}]"
    if layer:
        whole = whole.replace("tissue", within) if body < INCLUSION else f"{whole} in {within}"
    return f"{whole} beyond" if outside else whole


def present(problem: Problem) -> list[int]:
    """Return the numbers of the bodies of the mesh that have a material."""
    return [int(body) for body in np.unique(problem.solid.body) if int(body) in problem.materials]


def skin(problem: Problem) -> Faces:
    """Return the outer surface of all bodies together; for a half mesh it includes the plane of symmetry."""
    solid, faces, body = problem.solid, *_sides(problem, present(problem))
    _, index, count = np.unique(np.sort(faces[:, :3], axis=1), axis=0, return_index=True, return_counts=True)
    once = np.sort(index[count == 1])
    return _flat(solid.nodes, faces[once], body[once])


def section(problem: Problem, fields: SolidFields) -> Faces:
    """Return the cut at y = 0; fields are averaged at the nodes of each body separately, as they jump between bodies."""
    solid, nodes = problem.solid, problem.solid.nodes
    parts = []
    for body in present(problem):
        inside = solid.body == body
        averages = {"pressure": fields.vertical, "von_mises": fields.von_mises}
        values = {name: at_nodes(solid.elements[inside], each[inside], len(nodes)) for name, each in averages.items()}
        values["displacement"] = fields.displacement
        if solid.mesh.half:
            near = AT * float(np.ptp(nodes, axis=0).max())
            faces, _ = _sides(problem, [body])
            faces = faces[(np.abs(nodes[faces, 1]) < near).all(axis=1)]
            parts.append(_flat(nodes, faces, np.full(len(faces), body), values))
        else:
            parts.append(_sliced(nodes, solid.elements[inside], body, values))
    return _together([part for part in parts if len(part.triangles)])


def _sides(problem: Problem, bodies: list[int]) -> tuple[Ints, Ints]:
    """Return the four quadratic faces of the t elements of some bodies, shape (4 t, 6), and their bodies (4 t,)."""
    inside = np.isin(problem.solid.body, bodies)
    faces = problem.solid.elements[inside][:, _AROUND].reshape(-1, 6)
    return faces, np.repeat(problem.solid.body[inside], len(_AROUND))


def _flat(nodes: Floats, faces: Ints, body: Ints, values: Mapping[str, Floats] | None = None) -> Faces:
    """Split quadratic triangles (f, 6) into four flat ones each."""
    used, number = np.unique(faces, return_inverse=True)
    faces = number.reshape(-1, 6)
    lines = np.unique(np.sort(faces[:, RIM].reshape(-1, 2), axis=1), axis=0)
    own = {name: each[used] for name, each in (values or {}).items()}
    return Faces(nodes[used], faces[:, SPLIT].reshape(-1, 3), np.repeat(body, len(SPLIT)), lines, own)


def _sliced(nodes: Floats, elements: Ints, body: int, values: Mapping[str, Floats]) -> Faces:
    """Cut elements, split into eight flat tetrahedra each, slightly off y = 0, where no node lies."""
    import pyvista

    aside = {"normal": "y", "origin": (0, ASIDE * float(np.ptp(nodes, axis=0).max()), 0), "generate_triangles": True}
    sides = elements[:, _AROUND].reshape(-1, 6)
    _, first = np.unique(np.sort(sides[:, :3], axis=1), axis=0, return_index=True)
    whole = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: elements[:, EIGHT].reshape(-1, 4)}, nodes)
    faces = pyvista.PolyData.from_regular_faces(nodes, sides[first][:, SPLIT].reshape(-1, 3))
    for name, each in values.items():
        whole.point_data[name] = faces.point_data[name] = each
    area, rims = whole.slice(**aside), faces.slice(**aside)
    triangles = area.regular_faces if area.n_cells else np.zeros((0, 3), dtype=np.int64)
    lines = area.n_points + (rims.lines.reshape(-1, 3)[:, 1:] if rims.n_cells else np.zeros((0, 2), dtype=np.int64))
    own = {name: np.concatenate([part.point_data[name] for part in (area, rims)]) for name in values if len(triangles)}
    return Faces(np.vstack([area.points, rims.points]), triangles, np.full(len(triangles), body), lines, own)


def _together(parts: list[Faces]) -> Faces:
    """Merge faces into one set of points."""
    start = np.cumsum([0, *(len(part.points) for part in parts)])[:-1]
    return Faces(
        np.vstack([part.points for part in parts]),
        np.vstack([part.triangles + n for part, n in zip(parts, start, strict=True)]),
        np.concatenate([part.body for part in parts]),
        np.vstack([part.lines + n for part, n in zip(parts, start, strict=True)]),
        {name: np.concatenate([part.values[name] for part in parts]) for name in parts[0].values},
    )
