"""Check that a volume mesh represents the scene: connected bodies of the right volumes, an open gap, and no folded element."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from geometry.common.errors import SolveError
from geometry.scenes.probe import compute_groove_footprint
from geometry.tetra.body_layout import BodyLayout, Ellipsoid
from geometry.tetra.surface_files import Sheet
from geometry.tetra.tet_mesh import MeshBody, TetMesh, compute_volumes, match_faces

Indices = NDArray[np.int64]
_RELATIVE_TOLERANCE = 0.01  # relative
_FILE_RELATIVE_TOLERANCE = 0.05  # of a surface from a file, whose triangles need not be a mesh's
MIN_QUALITY = 0.01  # scaled Jacobian


def check_mesh(mesh: TetMesh, layout: BodyLayout) -> None:
    """Raise ``SolveError``, naming the defect, unless the mesh represents the scene."""
    quality = mesh.quality
    if not quality.min() > MIN_QUALITY:
        worst = int(quality.argmin())
        position = 1e3 * mesh.nodes[mesh.elements[worst, :4]].mean(axis=0)
        raise SolveError(f"volume mesh: an element of body {mesh.body[worst]} at {position.round(2)} mm is folded or flat "
                         f"(scaled Jacobian {quality[worst]:.1e})")  # fmt: skip
    file_names = {_name_inclusion(index) for index, body in enumerate(layout.inclusions) if isinstance(body, Sheet)}
    for name, error in compute_errors(mesh, layout).items():
        if not abs(error) <= (_FILE_RELATIVE_TOLERANCE if name in file_names else _RELATIVE_TOLERANCE):
            raise SolveError(f"volume mesh: {name} is {error:+.2%} off{_describe_cause(name, layout)}")
    inner, outer = (
        np.unique(mesh.elements[np.isin(mesh.body, bodies)]) for bodies in ([MeshBody.INNER], [MeshBody.OUTER, MeshBody.GROOVE])
    )
    if len(np.intersect1d(inner, outer)):
        raise SolveError("volume mesh: the gap is bridged")
    for label in np.unique(mesh.body):
        if (pieces := _count_pieces(mesh.elements[mesh.body == label, :4])) != 1 and not _may_be_split(layout, int(label)):
            raise SolveError(f"volume mesh: body {label} is in {pieces} pieces")


def find_max_error(mesh: TetMesh, layout: BodyLayout) -> float:
    """Return the largest absolute relative error of the volumes of blocks, groove, ellipsoids and tissue.

    The error of an ellipsoid further from the probe than its diameter is reduced in proportion to that distance.
    """
    errors = compute_volume_errors(mesh, layout)
    for index, body in enumerate(layout.inclusions):
        weight = 0.0 if isinstance(body, Sheet) else min(1.0, 2 * layout.tube / float(np.linalg.norm(body.centre)))
        errors[_name_inclusion(index)] *= weight
    return max(map(abs, errors.values()))


def find_max_file_error(mesh: TetMesh, layout: BodyLayout) -> float:
    """Return the largest absolute relative error of the volumes of bodies from files; 0 without any."""
    errors = compute_volume_errors(mesh, layout)
    names = (_name_inclusion(index) for index, body in enumerate(layout.inclusions) if isinstance(body, Sheet))
    return max((abs(errors[name]) for name in names), default=0.0)


def _name_inclusion(index: int) -> str:
    return f"inclusion[{index}]'s volume"


def _describe_cause(name: str, layout: BodyLayout) -> str:
    """Return the likely cause, in parentheses, if the body named comes from a surface file, else an empty text."""
    for index, body in enumerate(layout.inclusions):
        if isinstance(body, Sheet) and name.startswith(f"inclusion[{index}]"):
            crossing, opened = "its triangles may cross, or be too fine for the mesh", "it is open, its volume not well defined"
            return f" (the surface from its file: {crossing if body.is_closed else opened})"
    return ""


def compute_errors(mesh: TetMesh, layout: BodyLayout) -> dict[str, float]:
    """Return the relative errors of all volumes and areas that the scene determines, by name, 0.01 for 1 % too large."""
    return {**compute_volume_errors(mesh, layout), **_compute_area_errors(mesh, layout)}


def compute_volume_errors(mesh: TetMesh, layout: BodyLayout) -> dict[str, float]:
    """Return the relative errors of all volumes that the scene determines, by name."""
    volumes = compute_volumes(mesh.nodes, mesh.elements) * (2 if mesh.half else 1)
    is_tissue, tissue_area = mesh.body >= MeshBody.TISSUE, _compute_tissue_area(layout)
    cut = 0.0
    if layout.groove is not None:
        cut = compute_groove_footprint(layout.hole, layout.tube, layout.groove[0]) * layout.groove[1]
    tube = math.pi * (layout.tube**2 - layout.hole**2) * layout.outer_height
    selections = {
        "the inner block's volume": (mesh.body == MeshBody.INNER, math.pi * layout.inner**2 * layout.inner_height),
        "the outer block's volume": (mesh.body == MeshBody.OUTER, tube - cut),
        "the tissue's volume with its inclusions": (is_tissue, tissue_area * layout.depth),
    }
    if cut:
        selections["the groove's volume"] = (mesh.body == MeshBody.GROOVE, cut)
    for index, (top, bottom) in enumerate(pairwise((0.0, *layout.interfaces))):
        selections[f"tissue.layer[{index}]'s volume"] = (mesh.layer == index + 1, tissue_area * (bottom - top))
    if layout.wall is not None:
        selections["the reference cylinder's volume"] = (is_tissue & ~mesh.beyond, math.pi * layout.wall**2 * layout.depth)
    for index, body in enumerate(layout.inclusions):
        selections[_name_inclusion(index)] = (mesh.body == MeshBody.FIRST_INCLUSION + index, body.volume)
    return {name: float(volumes[rows].sum()) / expected - 1 for name, (rows, expected) in selections.items()}


def _compute_area_errors(mesh: TetMesh, layout: BodyLayout) -> dict[str, float]:
    """Return the relative errors of the areas of the blocks' ends and of the tissue's top, by name."""
    disc, ring = math.pi * layout.inner**2, math.pi * (layout.tube**2 - layout.hole**2)
    tissue_bodies = np.unique(mesh.body[mesh.body >= MeshBody.TISSUE]).tolist()
    ends = {
        "the inner block's film end": ([MeshBody.INNER], layout.inner_height, disc),
        "the outer block's film end": ([MeshBody.OUTER, MeshBody.GROOVE], layout.outer_height, ring),
        "the inner block's end on the tissue": ([MeshBody.INNER], 0.0, disc),
        "the outer block's end on the tissue": ([MeshBody.OUTER], 0.0, ring),
        "the tissue's top": (tissue_bodies, 0.0, _compute_tissue_area(layout)),
    }
    return {name: _measure_area(mesh, bodies, height) / expected - 1 for name, (bodies, height, expected) in ends.items()}


def _measure_area(mesh: TetMesh, bodies: list[int], height: float) -> float:
    """Return the area of the outer faces of ``bodies`` in the plane z = height, curved edges included."""
    faces = mesh.boundary(*bodies)
    level = np.abs(mesh.nodes[:, 2] - height) <= 1e-9 * np.abs(mesh.nodes).max()
    corners = mesh.nodes[faces[level[faces].all(axis=1)]][..., :2]
    if len(corners) == 0:
        return 0.0
    total = 0.0
    for k in range(3):  # the area within a path is the integral of (x dy - y dx) / 2: exact for parabolas by Simpson's rule
        # a side's first corner, middle and last corner
        a, m, b = corners[:, k], corners[:, 3 + k], corners[:, (k + 1) % 3]
        cross = (_cross(a, m) + _cross(m, b)) * 4 - _cross(a, b)
        total += float(cross.sum()) / 6
    return abs(total) * (2 if mesh.half else 1)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the z components of the cross products of vectors (n, 2), (n,)."""
    result: NDArray[np.float64] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return result


def _compute_tissue_area(layout: BodyLayout) -> float:
    """Return the area of the tissue's top, m^2."""
    return 4 * layout.sides[0] * layout.sides[1] if layout.tissue_radius is None else math.pi * layout.tissue_radius**2


def _count_pieces(tetrahedra: Indices) -> int:
    """Count the connected pieces of a mesh; tetrahedra connect by common faces."""
    first, second = match_faces(tetrahedra)[1] // 4
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(len(tetrahedra),) * 2)
    return int(connected_components(graph, directed=False)[0])


def _may_be_split(layout: BodyLayout, label: int) -> bool:
    """Return whether a body may be in several pieces: a surface from a file, or tissue outside the reference cylinder."""
    return label == MeshBody.BEYOND or (
        label >= MeshBody.FIRST_INCLUSION and not isinstance(layout.inclusions[label - MeshBody.FIRST_INCLUSION], Ellipsoid)
    )
