"""Extract the faces of a tetrahedral mesh that a picture shows: its skin, and its section at y = 0."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.tetra.tet_mesh import ELEMENT_FACES, MeshBody
from solver.solid.base_states import SolidFields, average_at_nodes
from solver.solid.problem import PLANE_TOLERANCE_RELATIVE, Problem
from solver.solid.regions import Region

REGION_NAMES: dict[int, str] = {
    MeshBody.INNER: "inner",
    MeshBody.OUTER: "outer",
    MeshBody.GROOVE: "groove",
    MeshBody.TISSUE: "tissue",
    MeshBody.BEYOND: "tissue beyond",
}
FLAT_TRIANGLES = np.array([(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)])  # a quadratic triangle as four flat ones
TRIANGLE_SIDES = np.array([(0, 3), (3, 1), (1, 4), (4, 2), (2, 5), (5, 0)])  # the sides of its six-node triangle, as pairs
FLAT_TETRAHEDRA = np.array(
    [(0, 4, 6, 7), (4, 1, 5, 8), (6, 5, 2, 9), (7, 8, 9, 3), (6, 8, 4, 5), (6, 8, 5, 9), (6, 8, 9, 7), (6, 8, 7, 4)]
)
SECTION_OFFSET_RELATIVE = 3.3e-6  # offset of the section from y = 0 over the size of the mesh, so that it meets no node


@dataclass(frozen=True)
class Faces:
    """Flat triangles, the lines of the mesh on them, and fields at their points.

    Attributes
    ----------
    points
        m, shape (n, 3).
    triangles
        Indices of their corners in ``points``, shape (f, 3).
    body
        Number of the region of each triangle, as in ``Solid.body``, shape (f,).
    lines
        Sides of elements as pairs of indices in ``points``, shape (m, 2).
    values
        Fields at the points by name: ``displacement`` in m (n, 3), ``pressure`` and ``von_mises`` in Pa (n,).
    """

    points: Floats
    triangles: Ints
    body: Ints
    lines: Ints
    values: Mapping[str, Floats] = field(default_factory=dict)


def name_region(number: int) -> str:
    """Return the name of a region, such as ``tissue.layer[k]``, ``inclusion[i] in tissue.layer[k]``, ``inclusion[i] beyond``."""
    body, layer, is_beyond = Region.from_number(number)
    region_name, layer_name = (
        REGION_NAMES.get(body) or f"inclusion[{body - MeshBody.FIRST_INCLUSION}]",
        f"tissue.layer[{layer - 1}]",
    )
    if layer:
        region_name = (
            region_name.replace("tissue", layer_name) if body < MeshBody.FIRST_INCLUSION else f"{region_name} in {layer_name}"
        )
    return f"{region_name} beyond" if is_beyond else region_name


def list_bodies(problem: Problem) -> list[int]:
    """Return the numbers of the bodies of the mesh that have a material."""
    return [int(body) for body in np.unique(problem.solid.body) if int(body) in problem.laws]


def extract_skin(problem: Problem) -> Faces:
    """Return the outer surface of all bodies together; for a half mesh it includes the plane of symmetry."""
    solid, faces, body = problem.solid, *_extract_faces(problem, list_bodies(problem))
    # a face inside belongs to two elements
    _, index, count = np.unique(np.sort(faces[:, :3], axis=1), axis=0, return_index=True, return_counts=True)
    outer = np.sort(index[count == 1])
    return _flatten_faces(solid.nodes, faces[outer], body[outer])


def cut_section(problem: Problem, fields: SolidFields) -> Faces:
    """Return the cut of the mesh at y = 0 with its fields.

    Fields are averaged at the nodes of each body separately, as they jump between bodies. A half mesh ends at the plane: its
    faces there are the cut; a whole mesh is sliced.
    """
    solid, nodes = problem.solid, problem.solid.nodes
    parts = []
    for body in list_bodies(problem):
        is_selected = solid.body == body
        averages = {"pressure": fields.vertical_stress, "von_mises": fields.von_mises}
        values = {
            name: average_at_nodes(solid.elements[is_selected], element_values[is_selected], len(nodes))
            for name, element_values in averages.items()
        }
        values["displacement"] = fields.displacement
        if solid.mesh.half:
            plane_tolerance = PLANE_TOLERANCE_RELATIVE * float(np.ptp(nodes, axis=0).max())
            faces, _ = _extract_faces(problem, [body])
            faces = faces[(np.abs(nodes[faces, 1]) < plane_tolerance).all(axis=1)]
            parts.append(_flatten_faces(nodes, faces, np.full(len(faces), body), values))
        else:
            parts.append(_slice_elements(nodes, solid.elements[is_selected], body, values))
    return merge_faces([part for part in parts if len(part.triangles)])


def _extract_faces(problem: Problem, bodies: list[int]) -> tuple[Ints, Ints]:
    """Return the four quadratic faces of the t elements of some bodies, shape (4 t, 6), and their bodies (4 t,)."""
    is_selected = np.isin(problem.solid.body, bodies)
    faces = problem.solid.elements[is_selected][:, ELEMENT_FACES].reshape(-1, 6)
    return faces, np.repeat(problem.solid.body[is_selected], len(ELEMENT_FACES))


def _flatten_faces(nodes: Floats, faces: Ints, body: Ints, values: Mapping[str, Floats] | None = None) -> Faces:
    """Return quadratic triangles, split into four flat ones each.

    Parameters
    ----------
    nodes
        m, shape (n, 3).
    faces
        Node numbers, corners then middles of sides, shape (f, 6).
    body
        Region of each, shape (f,).
    values
        Fields at all nodes, by name.
    """
    used_nodes, number = np.unique(faces, return_inverse=True)
    faces = number.reshape(-1, 6)
    lines = np.unique(np.sort(faces[:, TRIANGLE_SIDES].reshape(-1, 2), axis=1), axis=0)
    used_values = {name: node_values[used_nodes] for name, node_values in (values or {}).items()}
    return Faces(
        nodes[used_nodes], faces[:, FLAT_TRIANGLES].reshape(-1, 3), np.repeat(body, len(FLAT_TRIANGLES)), lines, used_values
    )


def _slice_elements(nodes: Floats, elements: Ints, body: int, values: Mapping[str, Floats]) -> Faces:
    """Return the cut through the elements of one body, slightly off y = 0, where no node lies.

    Each quadratic tetrahedron, (t, 10) node numbers, is split into eight flat ones. ``values`` are fields at all nodes, by name.
    """
    import pyvista

    origin = (0.0, SECTION_OFFSET_RELATIVE * float(np.ptp(nodes, axis=0).max()), 0.0)
    sides = elements[:, ELEMENT_FACES].reshape(-1, 6)
    _, first = np.unique(np.sort(sides[:, :3], axis=1), axis=0, return_index=True)
    grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: elements[:, FLAT_TETRAHEDRA].reshape(-1, 4)}, nodes)
    triangles = sides[first][:, FLAT_TRIANGLES].reshape(-1, 3)
    faces = pyvista.PolyData.from_regular_faces(nodes, triangles)  # type: ignore[arg-type]  # pyvista says int for integers
    for name, node_values in values.items():
        grid.point_data[name] = faces.point_data[name] = node_values
    # the tetrahedra give the area of the cut, their faces the lines of the mesh on it
    area, rims = (part.slice(normal="y", origin=origin, generate_triangles=True) for part in (grid, faces))
    section = area.regular_faces if area.n_cells else np.zeros((0, 3), dtype=np.int64)
    lines = area.n_points + (rims.lines.reshape(-1, 3)[:, 1:] if rims.n_cells else np.zeros((0, 2), dtype=np.int64))
    cut_values = {name: np.concatenate([part.point_data[name] for part in (area, rims)]) for name in values if len(section)}
    return Faces(np.vstack([area.points, rims.points]), section, np.full(len(section), body), lines, cut_values)


def merge_faces(parts: Sequence[Faces]) -> Faces:
    """Merge faces into one set of points, with the fields that all of them have."""
    start = np.cumsum([0, *(len(part.points) for part in parts)])[:-1]
    common_fields = [name for name in parts[0].values if all(name in part.values for part in parts)]
    return Faces(
        np.vstack([part.points for part in parts]),
        np.vstack([part.triangles + n for part, n in zip(parts, start, strict=True)]),
        np.concatenate([part.body for part in parts]),
        np.vstack([part.lines + n for part, n in zip(parts, start, strict=True)]),
        {name: np.concatenate([part.values[name] for part in parts]) for name in common_fields},
    )
