"""Whether a volume mesh is the scene: bodies whole, as large as they are, apart where the gap is, and no element folded."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from geometry.common.errors import SolveError
from geometry.tetra.layout import BodyLayout, Ellipsoid
from geometry.tetra.surface_files import Sheet
from geometry.tetra.tet_mesh import BEYOND, FACES, GROOVE, INCLUSION, INNER, OUTER, TISSUE, TetMesh, element_volumes

Indices = NDArray[np.int64]
_VOLUME = 0.01  # relative
_FILE_VOLUME = 0.05  # of a surface from a file, whose triangles need not be a mesh's
LEAST_QUALITY = 0.01  # scaled Jacobian


def check(mesh: TetMesh, layout: BodyLayout) -> None:
    """Raise ``SolveError``, naming what is wrong, unless the mesh is the scene's."""
    quality = mesh.quality
    if not quality.min() > LEAST_QUALITY:
        worst = int(quality.argmin())
        at = 1e3 * mesh.nodes[mesh.elements[worst, :4]].mean(axis=0)
        raise SolveError(f"volume mesh: an element of body {mesh.body[worst]} at {at.round(2)} mm is folded or flat "
                         f"(scaled Jacobian {quality[worst]:.1e})")  # fmt: skip
    for name, (is_, expected, allowed) in {**_volumes(mesh, layout), **_areas(mesh, layout)}.items():
        if not abs(is_ - expected) <= allowed * expected:
            raise SolveError(f"volume mesh: {name} is {is_ / expected - 1:+.2%} off{_why(name, layout)}")
    inner, outer = (np.unique(mesh.elements[np.isin(mesh.body, bodies)]) for bodies in ([INNER], [OUTER, GROOVE]))
    if len(np.intersect1d(inner, outer)):
        raise SolveError("volume mesh: the gap is bridged")
    for label in np.unique(mesh.body):
        if (pieces := _pieces(mesh.elements[mesh.body == label, :4])) != 1 and not _may_be_split(layout, int(label)):
            raise SolveError(f"volume mesh: body {label} is in {pieces} pieces")


def largest_error(mesh: TetMesh, layout: BodyLayout) -> float:
    """Return the largest absolute relative error of the volumes of blocks, groove, ellipsoids and tissue.

    That of an ellipsoid further from the probe than its diameter counts less, as much as it is further.
    """
    near = {
        f"inclusion[{k}]'s volume": 2 * layout.tube / float(np.linalg.norm(b.centre)) for k, b in enumerate(layout.inclusions)
    }
    relative = {name: is_ / exact - 1 for name, (is_, exact, allowed) in _volumes(mesh, layout).items() if allowed == _VOLUME}
    return max(abs(error) * min(1.0, near.get(name, 1.0)) for name, error in relative.items())


def files_error(mesh: TetMesh, layout: BodyLayout) -> float:
    """Return the largest absolute relative error of the volumes of bodies from files; 0 without any."""
    kinds = _volumes(mesh, layout).values()
    return max((abs(is_ / exact - 1) for is_, exact, allowed in kinds if allowed == _FILE_VOLUME), default=0.0)


def _why(name: str, layout: BodyLayout) -> str:
    """Return the likely cause, in parentheses, if the body named comes from a surface file, else an empty text."""
    for index, body in enumerate(layout.inclusions):
        if isinstance(body, Sheet) and name.startswith(f"inclusion[{index}]"):
            crossing, opened = "its triangles may cross, or be too fine for the mesh", "it is open, its volume not well defined"
            return f" (the surface from its file: {crossing if body.closed else opened})"
    return ""


def errors(mesh: TetMesh, layout: BodyLayout) -> dict[str, float]:
    """Return the relative errors of all known volumes and areas by name."""
    return {name: is_ / expected - 1 for name, (is_, expected, _) in {**_volumes(mesh, layout), **_areas(mesh, layout)}.items()}


def _volumes(mesh: TetMesh, layout: BodyLayout) -> dict[str, tuple[float, float, float]]:
    """Return by name a volume in the mesh, its exact value, and the allowed relative error."""
    volumes = element_volumes(mesh.nodes, mesh.elements) * (2 if mesh.half else 1)

    def of(label: int) -> float:
        return float(volumes[mesh.body == label].sum())

    footprint, below = _footprint(layout), mesh.body >= TISSUE
    cut = 0.0 if layout.groove is None else footprint * layout.groove[1]
    whole = _tissue_area(layout) * layout.depth
    tube = math.pi * (layout.tube**2 - layout.hole**2) * layout.outer_height
    result = {
        "the inner block's volume": (of(INNER), math.pi * layout.inner**2 * layout.inner_height, _VOLUME),
        "the outer block's volume": (of(OUTER), tube - cut, _VOLUME),
        "the tissue's volume with its inclusions": (float(volumes[below].sum()), whole, _VOLUME),
    }
    if cut:
        result["the groove's volume"] = (of(GROOVE), cut, _VOLUME)
    for index, (top, bottom) in enumerate(pairwise((0.0, *layout.interfaces))):
        own = float(volumes[mesh.layer == index + 1].sum())
        result[f"tissue.layer[{index}]'s volume"] = (own, _tissue_area(layout) * (bottom - top), _VOLUME)
    if layout.wall is not None:
        inside = float(volumes[below & ~mesh.beyond].sum())
        result["the reference cylinder's volume"] = (inside, math.pi * layout.wall**2 * layout.depth, _VOLUME)
    for index, body in enumerate(layout.inclusions):
        allowed = _VOLUME if isinstance(body, Ellipsoid) else _FILE_VOLUME
        result[f"inclusion[{index}]'s volume"] = (of(INCLUSION + index), body.volume, allowed)
    return result


def _areas(mesh: TetMesh, layout: BodyLayout) -> dict[str, tuple[float, float, float]]:
    disc, ring = math.pi * layout.inner**2, math.pi * (layout.tube**2 - layout.hole**2)
    result = {"the inner block's film end": (_area(mesh, [INNER], layout.inner_height), disc, _VOLUME)}
    result["the outer block's film end"] = (_area(mesh, [OUTER, GROOVE], layout.outer_height), ring, _VOLUME)
    result["the inner block's end on the tissue"] = (_area(mesh, [INNER], 0.0), disc, _VOLUME)
    result["the outer block's end on the tissue"] = (_area(mesh, [OUTER], 0.0), ring, _VOLUME)
    below = np.unique(mesh.body[mesh.body >= TISSUE]).tolist()
    result["the tissue's top"] = (_area(mesh, below, 0.0), _tissue_area(layout), _VOLUME)
    return result


def _area(mesh: TetMesh, bodies: list[int], height: float) -> float:
    """Return the area of the outer faces of ``bodies`` in the plane z = height, curved edges included."""
    faces = mesh.boundary(*bodies)
    level = np.abs(mesh.nodes[:, 2] - height) <= 1e-9 * np.abs(mesh.nodes).max()
    corners = mesh.nodes[faces[level[faces].all(axis=1)]][..., :2]
    if len(corners) == 0:
        return 0.0
    total = 0.0
    for k in range(3):  # the area within a path is the integral of (x dy - y dx) / 2: exact for parabolas by Simpson's rule
        a, m, b = corners[:, k], corners[:, 3 + k], corners[:, (k + 1) % 3]
        cross = (_cross(a, m) + _cross(m, b)) * 4 - _cross(a, b)
        total += float(cross.sum()) / 6
    return abs(total) * (2 if mesh.half else 1)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    result: NDArray[np.float64] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return result


def _footprint(layout: BodyLayout) -> float:
    if layout.groove is None:
        return 0.0
    a = layout.groove[0]
    strips = [r * r * math.asin(a / r) + a * math.sqrt(r * r - a * a) for r in (layout.tube, layout.hole)]
    return strips[0] - strips[1]


def _tissue_area(layout: BodyLayout) -> float:
    return 4 * layout.sides[0] * layout.sides[1] if layout.tissue_radius is None else math.pi * layout.tissue_radius**2


def _pieces(tetrahedra: Indices) -> int:
    """Count the connected pieces of a mesh; tetrahedra connect by common faces."""
    faces = np.sort(tetrahedra[:, FACES].reshape(-1, 3), axis=1)
    owner = np.repeat(np.arange(len(tetrahedra)), 4)
    order = np.lexsort(faces.T)
    same = np.flatnonzero((faces[order[1:]] == faces[order[:-1]]).all(axis=1))
    one, other = owner[order[same]], owner[order[same + 1]]
    graph = coo_array((np.ones(len(one)), (one, other)), shape=(len(tetrahedra),) * 2)
    return int(connected_components(graph, directed=False)[0])


def _may_be_split(layout: BodyLayout, label: int) -> bool:
    """Return whether a body may be in several pieces: one from a file, or tissue outside the reference cylinder."""
    return label == BEYOND or (label >= INCLUSION and not isinstance(layout.inclusions[label - INCLUSION], Ellipsoid))
