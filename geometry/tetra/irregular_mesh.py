"""Mesh any layout by pytetwild, from netgen's surfaces of its shapes and from the triangles of its files.

pytetwild is called once for all surfaces, in a space where the gap is wide and far tissue near
(``geometry.tetra.stretched_space``). Its tetrahedra are labelled by the surfaces that enclose them there, and its nodes move
to the exact surfaces. Layers of tissue are cut afterwards (``geometry.tetra.layers``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Arrays, Points
from geometry.common.winding import WindingTree
from geometry.mesh_programs.tetwild import tetrahedralize
from geometry.tetra.body_layout import BodyLayout
from geometry.tetra.layers import cut_by_planes
from geometry.tetra.regular_mesh import mesh_shapes
from geometry.tetra.sizing import TetraFineness, build_background, choose_space
from geometry.tetra.smoothing import remove_slivers, smooth, undo_inversions
from geometry.tetra.snapping import (
    build_exact_surfaces,
    curve_mesh,
    find_interfaces,
    find_memberships,
    find_surface_faces,
    snap,
    snap_to_permanent,
)
from geometry.tetra.stretched_space import MeshSpace
from geometry.tetra.surface_files import Sheet
from geometry.tetra.tet_mesh import MeshBody, TetMesh, match_faces

Indices = NDArray[np.int64]
_ENVELOPE_FRACTION = 0.15  # of the smallest feature: how far pytetwild's surfaces may be from the given ones
_ENVELOPE_REDUCTION = 0.7  # the envelope from trial to trial: pytetwild's time goes with its square
_MAX_DECIMATION_FRACTION = 0.25  # of the envelope: how far fewer triangles may be from a surface that they stand for
_NEAR_FEATURE_FRACTION, _FAR_FEATURE_FRACTION = 0.5, 0.7  # of an inclusion's smallest semi-axis: what counts as a feature
_TIME_LIMITS_S = 240.0, 600.0, 600.0  # s for pytetwild in each trial: no two runs are alike, and one in many never ends
_MAX_ITERATIONS = 25  # of pytetwild: where these do not do, more hardly help
_STOP_ENERGY = 10.0  # of pytetwild: quality at which it stops
_MAX_RELATIVE_SIZE = 0.1  # of all surfaces' extent: tetrahedra above it cost, as pytetwild fills a box that is larger by as much
_SIZE_FIELD_MARGIN = 0.15  # of the box's diagonal: by how much the sizes' field is larger than the surfaces
_CURVATURE_SAFETY = (
    4.0  # radius of curvature over edge length of netgen's triangles: with 2 spheres lose a hundredth of their volume
)
_INSIDE_WINDING = 0.5  # winding number from which a point counts as inside
_MEND_BELOW_RATIO = 0.2  # straight tetrahedra below this mean ratio are mended
_MIN_MENDED_RATIO = 0.05  # those that stay below this are put back to where pytetwild had them, off all but the outer planes
_MIN_KEPT_QUALITY = 0.2  # of its quality an element keeps when its edges are curved, or they stay straight


@dataclass(frozen=True)
class SurfaceSoup:
    """All surfaces in the mesher's space, as triangles that may cross: the input of pytetwild.

    Attributes
    ----------
    points, triangles
        (n, 3) in m, and (t, 3).
    enclosures
        The closed surface of each body that is a shape, by its label.
    """

    points: Points
    triangles: NDArray[np.int32]
    enclosures: dict[int, WindingTree]


def mesh_irregular_layout(layout: BodyLayout, fineness: TetraFineness, trial: int) -> TetMesh:
    """Mesh a layout, with a tighter envelope at each ``trial``; raises as ``mesh_shapes`` and ``tetrahedralize``.

    The envelope is how far pytetwild's surfaces may be from the given ones. ``trial`` counts from 0.
    """
    space = choose_space(layout, fineness)
    max_envelope = _ENVELOPE_FRACTION * _find_smallest_feature(layout, space)
    soup = _build_soup(layout, fineness, space, max_envelope)
    envelope = _ENVELOPE_REDUCTION**trial * max_envelope
    nodes, cells = _tetrahedralize(layout, fineness, space, soup, envelope=envelope, patience=_TIME_LIMITS_S[trial])
    return _finish_mesh(layout, space, soup.enclosures, nodes, cells)


def _build_soup(layout: BodyLayout, fineness: TetraFineness, space: MeshSpace, envelope: float) -> SurfaceSoup:
    """Join netgen's faces between shapes with the triangles of surface files.

    A file's decimated triangles are used where there are any that stay well within the envelope, m.
    """
    shapes = mesh_shapes(replace(layout, interfaces=()), fineness, _CURVATURE_SAFETY)
    images = space.to_mesh(shapes.points)
    faces, _, _ = find_interfaces(shapes.cells, shapes.body)
    used, number = np.unique(faces, return_inverse=True)
    points, triangles = [images[used]], [number.reshape(-1, 3)]
    for body in layout.inclusions:
        if isinstance(body, Sheet):
            is_decimated = body.fewer is not None and body.decimation_error <= _MAX_DECIMATION_FRACTION * envelope
            sheet = body.fewer if body.fewer is not None and is_decimated else body
            triangles.append(sheet.triangles + sum(map(len, points)))
            points.append(space.to_mesh(sheet.points))
    enclosures = {}
    for label in np.unique(shapes.body).tolist():
        sides, _, outer = match_faces(shapes.cells[shapes.body == label])
        enclosures[label] = WindingTree.from_triangles(images[sides[outer]])
    return SurfaceSoup(np.vstack(points), np.vstack(triangles).astype(np.int32), enclosures)


def _find_smallest_feature(layout: BodyLayout, space: MeshSpace) -> float:
    """Return the smallest feature of the bodies in the mesher's space, in m: a width, height, semi-axis or overburden."""
    lengths = [layout.gap + space.moved[2] - space.moved[1], layout.tube - layout.hole, layout.inner_height, layout.outer_height]
    if layout.groove is not None:
        lengths += [2 * layout.groove[0], layout.groove[1]]
    for body in layout.inclusions:
        scale = float(space.compute_scale(body.centre[None, :])[0])
        fraction = _FAR_FEATURE_FRACTION + scale * (_NEAR_FEATURE_FRACTION - _FAR_FEATURE_FRACTION)
        cover = float(-body.centre[2] - body.reach[2])
        lengths += [fraction * scale * body.min_semi_axis, 2 * scale * cover]
    return min(length for length in lengths if length > 0)


def _tetrahedralize(
    layout: BodyLayout, fineness: TetraFineness, space: MeshSpace, soup: SurfaceSoup, *, envelope: float, patience: float
) -> tuple[Points, Indices]:
    """Return nodes (n, 3) and tetrahedra (t, 4) that pytetwild makes in the mesher's space; ``envelope`` in m, ``patience`` in s.

    Lengths are passed to it relative to the diagonal of the box around all surfaces.
    """
    low, high = soup.points.min(axis=0), soup.points.max(axis=0)
    diagonal = float(np.linalg.norm(high - low))
    margin = _SIZE_FIELD_MARGIN * diagonal
    grid, grid_cells, sizes = build_background(layout, fineness, space, np.array([low - margin, high + margin]))
    relative_sizes = np.minimum(sizes / diagonal, _MAX_RELATIVE_SIZE)
    arguments: Arrays = {
        "vertices": soup.points / diagonal,
        "faces": soup.triangles,
        "edge_length_abs": np.array(float(relative_sizes.max())),
        "epsilon": np.array(envelope / diagonal),
        "disable_filtering": np.array(True),
        "num_opt_iter": np.array(_MAX_ITERATIONS),
        "stop_energy": np.array(_STOP_ENERGY),
        "bg_vertices": grid / diagonal,
        "bg_tets": grid_cells,
        "bg_values": relative_sizes,
    }
    nodes, cells = tetrahedralize(arguments, patience)
    return nodes * diagonal, cells


def _label_cells(
    layout: BodyLayout, space: MeshSpace, enclosures: dict[int, WindingTree], middles: Points
) -> tuple[Indices, NDArray[np.bool_]]:
    """Return the body of tetrahedra with these middles, (t,), and whether they lie outside the reference cylinder, (t,).

    ``middles`` (t, 3) are in the mesher's space. ``enclosures`` are the closed surfaces of the shapes, by label.
    """
    body = np.full(len(middles), MeshBody.AIR)
    for label, surface in enclosures.items():
        low, high = surface.corners.min(axis=(0, 1)), surface.corners.max(axis=(0, 1))
        rows = np.flatnonzero(((middles >= low) & (middles <= high)).all(axis=1))
        body[rows[np.abs(surface.compute_winding(middles[rows])) > _INSIDE_WINDING]] = label
    scene_middles = space.to_scene(middles)
    wall = np.inf if layout.wall is None else layout.wall
    is_inclusion = body >= MeshBody.FIRST_INCLUSION
    is_beyond = (body == MeshBody.BEYOND) | (is_inclusion & (np.hypot(*scene_middles[:, :2].T) > wall))
    for index, inclusion in enumerate(layout.inclusions):
        if isinstance(inclusion, Sheet):
            body[(body >= MeshBody.TISSUE) & inclusion.is_inside(scene_middles)] = MeshBody.FIRST_INCLUSION + index
    if layout.half:
        body[middles[:, 1] < 0] = MeshBody.MIRROR
    return body, is_beyond


def _finish_mesh(
    layout: BodyLayout, space: MeshSpace, enclosures: dict[int, WindingTree], nodes: Points, cells: Indices
) -> TetMesh:
    """Label tetrahedra, move nodes to the exact surfaces, improve and curve elements, and drop those outside."""
    points = space.to_scene(nodes)
    body, is_beyond = _label_cells(layout, space, enclosures, nodes[cells].mean(axis=1))
    exact = build_exact_surfaces(layout)
    faces, chosen = find_surface_faces(exact, points, cells, body)
    body, faces, chosen = remove_slivers(exact, points, cells, body=body, faces=faces, chosen=chosen)
    member = find_memberships(len(points), faces, chosen, len(exact))
    is_used = body >= 0
    vertices, number = np.unique(cells[is_used], return_inverse=True)
    renumber = np.full(len(points), -1)
    renumber[vertices] = np.arange(len(vertices))
    cells, member, faces = number.reshape(-1, 4), member[vertices], renumber[faces]
    straight = smooth(snap(exact, points[vertices], member), cells, exact, member, min_ratio=_MEND_BELOW_RATIO, rounds=6)
    straight = undo_inversions(straight, snap_to_permanent(exact, points[vertices], member), cells, _MIN_MENDED_RATIO)
    body, is_beyond, layer = body[is_used], is_beyond[is_used], np.zeros(len(cells), dtype=np.int64)
    if layout.interfaces:
        cut = cut_by_planes(layout, exact, straight, cells, body=body, member=member)
        straight, cells, faces, chosen, layer = cut.points, cut.cells, cut.faces, cut.chosen, cut.layer
        body, is_beyond = body[cut.parent], is_beyond[cut.parent]
    quadratic, elements = curve_mesh(straight, cells, exact, faces=faces, chosen=chosen, keep=_MIN_KEPT_QUALITY)
    return TetMesh(quadratic, elements, body, is_beyond, np.where(body < MeshBody.TISSUE, 0, layer), layout.half)
