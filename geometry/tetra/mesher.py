"""Mesh a scene by quadratic tetrahedra labelled by body: by netgen, or by pytetwild and projection on the exact surfaces.

pytetwild is called once for all surfaces, in a space where the gap is wide and far tissue near
(``geometry.tetra.stretched_space``). A mesh that fails the checks is made again, finer; one that fails still is refused,
never used.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.cad.decimation import DECIMATED_TRIANGLES, MAX_DIRECT_TRIANGLES
from geometry.common.arrays import Arrays, Ints, Points
from geometry.common.errors import SolveError
from geometry.common.resources import check_time
from geometry.mesh_programs.tetwild import tetrahedralize
from geometry.processes.child import Failure, TooLong
from geometry.tetra.body_layout import BodyLayout
from geometry.tetra.facets import halve_triangles
from geometry.tetra.labels import label_points
from geometry.tetra.layers import cut_by_planes
from geometry.tetra.mesh_check import check_mesh, find_max_error
from geometry.tetra.regular_mesh import estimate_regular_elements, is_regular, mesh_regular_layout
from geometry.tetra.sizing import COARSE_FINENESS, FINE_FINENESS, ROUGH_FINENESS, TetraFineness, build_background, count_squares
from geometry.tetra.smoothing import remove_slivers, smooth, undo_inversions
from geometry.tetra.snapping import (
    build_exact_surfaces,
    curve_mesh,
    find_interfaces,
    find_memberships,
    find_surfaces,
    snap,
    snap_to_permanent,
)
from geometry.tetra.stretched_space import MeshSpace, choose_mesh_space
from geometry.tetra.surface_files import Sheet
from geometry.tetra.surfaces import Corners, build_surfaces, choose_corners
from geometry.tetra.tet_mesh import TISSUE_BODY, TetMesh

__all__ = ["COARSE_FINENESS", "FINE_FINENESS", "ROUGH_FINENESS", "TetraFineness", "Timing", "estimate_elements", "mesh_layout"]

_LINEAR_RADIUS_FACTOR = 1.7  # far tissue begins at this many times the probe's largest length
_ENVELOPE_FRACTION = (
    0.15  # of the smallest feature: how far pytetwild's surfaces may be from the given ones; never above half the gap
)
_MAX_DECIMATION_FRACTION = 0.25  # of the envelope: how far fewer triangles may be from a surface that they stand for
_INCLUSION_FEATURE_FRACTIONS = (
    0.5,
    0.7,
)  # of an inclusion's least semi-axis, near the probe and far from it: what counts as a feature
_MAX_GAP_WIDENING = 12  # the gap becomes wider by this factor at most: tetrahedra below it are squeezed as much on the way back
_GAP_RISE_FACTOR = 1.0  # how much faster the gap becomes wider upwards than the tetrahedra become larger
_MEND_BELOW_RATIO = 0.2  # straight tetrahedra below this mean ratio are mended
_MIN_MENDED_RATIO = 0.05  # those that stay below this are put back to where pytetwild had them, off all but the outer planes
_MIN_KEPT_QUALITY = 0.2  # of its quality an element keeps when its edges are curved, or they stay straight
_MAX_TRIALS = 3
_TETWILD_TIME_LIMITS_S = 240.0, 600.0, 600.0  # s for pytetwild in each: no two runs are alike, and one in many never ends
_NETGEN_MIN_TIME_S, _NETGEN_MIN_RATE = 30.0, 500.0  # s for netgen, and tetrahedra in a second beyond: it makes some 6000
_ENVELOPE_REDUCTION = 0.7  # the envelope from trial to trial: pytetwild's time goes with its square
_ACCEPTED_VOLUME_ERROR = 3e-3  # error of a block's or ellipsoid's volume above which another trial is made
_TETWILD_MAX_ITERATIONS = 25  # of pytetwild: where these do not do, more hardly help
_TETWILD_STOP_ENERGY = 10.0  # of pytetwild: quality at which it stops
_MAX_RELATIVE_SIZE = 0.1  # of all surfaces' extent: tetrahedra above it cost, as pytetwild fills a box that is larger by as much
_SIDE_ROWS = 12  # of quadrilaterals down the tissue's side
_SIZE_FIELD_MARGIN = 0.15  # of the box's diagonal: by how much the sizes' field is larger than the surfaces
_TETRAHEDRA_PER_CUBE = 6 * 2**0.5  # regular tetrahedra in the cube of their edge
_TETRAHEDRA_PER_SQUARE = 11.0  # tetrahedra that a plane adds by cutting a square of their edge


@dataclass(frozen=True)
class Timing:
    """Which mesher made a mesh, in how many seconds and trials."""

    mesher: str
    seconds: float
    trials: int


@dataclass(frozen=True)
class Mesher:
    """A library by name, and how it makes a mesh of a layout at the trial 0, 1 or 2."""

    name: str
    trial: Callable[[BodyLayout, TetraFineness, int], TetMesh]


def mesh_layout(layout: BodyLayout, fineness: TetraFineness) -> tuple[TetMesh, Timing]:
    """Mesh regular layouts by netgen; others, and those of which it makes no mesh that passes the checks, by pytetwild.

    Returns
    -------
    tuple[TetMesh, Timing]
        The mesh with the smallest volume error of those that passed the checks, and how long all trials took.

    Raises
    ------
    SolveError
        None passed, or pytetwild took longer than its limit twice; the text says why.
    LimitReached
        The time is over before there is a mesh.
    KeyboardInterrupt
        Ctrl-C, at once.
    """
    if is_regular(layout):
        with suppress(SolveError):
            return _try_mesher(layout, fineness, NETGEN_MESHER)
    return _try_mesher(layout, fineness, TETWILD_MESHER)


def _try_mesher(layout: BodyLayout, fineness: TetraFineness, mesher: Mesher) -> tuple[TetMesh, Timing]:
    """Mesh a layout; again, finer, if a mesh fails the checks or a volume error is above 0.3 %; see ``mesh_layout``."""
    fault, best, min_error = "", None, np.inf
    trials, start = 0, time.perf_counter()
    while trials < _MAX_TRIALS and min_error > _ACCEPTED_VOLUME_ERROR:
        try:
            mesh = mesher.trial(layout, fineness, trials)
            check_mesh(mesh, layout)
            if (error := find_max_error(mesh, layout)) < min_error:
                best, min_error = mesh, error
        except TooLong as failure:
            if best is None:
                check_time(_describe_work(layout))
            fault = f"{mesher.name}: {failure}"
            if trials > 0:
                break
        except Failure as failure:
            fault = f"{mesher.name}: {failure}"
        except SolveError as failure:
            fault = str(failure).removeprefix("volume mesh: ")
        trials += 1
        fineness = replace(fineness, rim=0.9 * fineness.rim, sphere=0.9 * fineness.sphere, corners=fineness.corners + 4)
    if best is None:
        raise SolveError(f"volume mesh: none passed the checks, the last one as {fault}")
    return best, Timing(mesher.name, time.perf_counter() - start, trials)


def _describe_work(layout: BodyLayout) -> str:
    """Describe the work that takes long, and what would shorten it."""
    uneven = [len(body.triangles) for body in layout.inclusions if isinstance(body, Sheet) and body.fewer is None]
    if max(uneven, default=0) <= MAX_DIRECT_TRIANGLES:
        return "meshing"
    return (
        f"meshing a surface of {max(uneven)} triangles too uneven to be followed by {DECIMATED_TRIANGLES} (a "
        "smoother one takes less)"
    )


def estimate_elements(layout: BodyLayout, fineness: TetraFineness) -> float:
    """Return about how many tetrahedra a layout's mesh will have, from their sizes alone, in a moment.

    See ``estimate_regular_elements`` for netgen. Of pytetwild meshes with 5000 to 250 000 tetrahedra they are 0.97 to 1.6 x as
    many, large ones nearer to 1; what planes between layers add is 1 to 1.8 times as many.
    """
    if is_regular(layout):
        return estimate_regular_elements(layout, fineness, choose_space(layout, fineness))
    space, _, soup, sizes = _prepare_tetwild(layout, fineness)
    grid, cells, values = (
        sizes[0],
        sizes[1],
        np.minimum(sizes[2], _MAX_RELATIVE_SIZE * float(np.linalg.norm(np.ptp(soup[0], axis=0)))),
    )
    corners = grid[cells]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    inside = layout.contains(space.to_scene(corners.mean(axis=1)))
    whole = float(_TETRAHEDRA_PER_CUBE * (volume / values[cells].mean(axis=1) ** 3)[inside].sum())
    return whole + _TETRAHEDRA_PER_SQUARE * count_squares(layout, fineness, space)


def _prepare_tetwild(
    layout: BodyLayout, fineness: TetraFineness
) -> tuple[MeshSpace, Corners, tuple[Points, NDArray[np.int32]], tuple[Points, NDArray[np.int32], Points]]:
    """Return the mesher's space, the polygons that stand for circles, surfaces in that space, and the sizes wanted there."""
    space, turns = choose_space(layout, fineness), choose_corners(layout, fineness.corners)
    layout = _replace_fine_surfaces(layout, space)
    coarse = build_surfaces(layout, turns, space.linear_radius, _SIDE_ROWS, max(5, round(2.5 / fineness.sphere)))
    points, triangles = _map_to_mesh_space(layout, space, halve_triangles(*coarse, layout, fineness, space))
    box = np.array([points.min(axis=0), points.max(axis=0)])
    margin = _SIZE_FIELD_MARGIN * float(np.linalg.norm(box[1] - box[0]))
    return space, turns, (points, triangles), build_background(layout, fineness, space, box + np.array([[-margin], [margin]]))


def _mesh_by_netgen(layout: BodyLayout, fineness: TetraFineness, trial: int) -> TetMesh:
    """Mesh a layout by netgen; a later trial differs by its slightly smaller sizes."""
    return mesh_regular_layout(
        layout,
        fineness,
        choose_space(layout, fineness),
        _NETGEN_MIN_TIME_S + estimate_elements(layout, fineness) / _NETGEN_MIN_RATE,
    )


def _mesh_by_tetwild(layout: BodyLayout, fineness: TetraFineness, trial: int) -> TetMesh:
    """Mesh a layout by pytetwild, with a tighter envelope at each trial."""
    space, turns, (points, triangles), sizes = _prepare_tetwild(layout, fineness)
    envelope = _ENVELOPE_FRACTION * _ENVELOPE_REDUCTION**trial * _find_smallest_feature(layout, space)
    return _finish_mesh(layout, space, turns, *_tetrahedralize(points, triangles, envelope, sizes, _TETWILD_TIME_LIMITS_S[trial]))


NETGEN_MESHER, TETWILD_MESHER = Mesher("netgen", _mesh_by_netgen), Mesher("pytetwild", _mesh_by_tetwild)


def choose_space(layout: BodyLayout, fineness: TetraFineness) -> MeshSpace:
    """Choose mesher's space: a gap as wide as tetrahedra at its rims, tissue beyond the probe and surface files drawn near."""
    sheets = [float(np.linalg.norm(body.points, axis=1).max()) for body in layout.inclusions if isinstance(body, Sheet)]
    linear_radius = max(
        _LINEAR_RADIUS_FACTOR * max(layout.tube, layout.inner_height, layout.outer_height), *(1.05 * size for size in sheets), 0.0
    )
    wide = min(fineness.rim * layout.inner, _MAX_GAP_WIDENING * layout.gap)
    height = max(layout.inner_height, layout.outer_height)
    return choose_mesh_space(
        layout.inner,
        layout.hole,
        layout.tube,
        gap=wide,
        linear_radius=linear_radius,
        height=height,
        rise=_GAP_RISE_FACTOR * fineness.growth * height,
    )


def _replace_fine_surfaces(layout: BodyLayout, space: MeshSpace) -> BodyLayout:
    """Return the layout with fewer triangles for surfaces of very many, where these stay well within the envelope.

    Only pytetwild uses these: labels, nodes and checks use the file's own triangles.
    """
    allowed = _MAX_DECIMATION_FRACTION * _ENVELOPE_FRACTION * _find_smallest_feature(layout, space)
    bodies = (body.fewer if isinstance(body, Sheet) and body.decimation_error <= allowed else None for body in layout.inclusions)
    return replace(
        layout, inclusions=tuple(decimated or original for decimated, original in zip(bodies, layout.inclusions, strict=True))
    )


def _map_to_mesh_space(layout: BodyLayout, space: MeshSpace, soup: tuple[Points, Ints]) -> tuple[Points, NDArray[np.int32]]:
    """Map the surfaces, with the plane of symmetry, a rectangle beyond them all, for half a scene."""
    points, triangles = space.to_mesh(soup[0]), soup[1]
    if layout.half:
        points[np.abs(points[:, 1]) < 1e-9 * np.abs(points).max(), 1] = 0.0  # what lies on the plane up to rounding lies on it
        low, high = points.min(axis=0), points.max(axis=0)
        low, high = low - 0.02 * (high - low), high + 0.02 * (high - low)
        plane = [(low[0], 0.0, low[2]), (high[0], 0.0, low[2]), (high[0], 0.0, high[2]), (low[0], 0.0, high[2])]
        n = len(points)
        points, triangles = np.vstack([points, plane]), np.vstack([triangles, [(n, n + 1, n + 2), (n, n + 2, n + 3)]])
    return points, triangles.astype(np.int32)


def _find_smallest_feature(layout: BodyLayout, space: MeshSpace) -> float:
    """Return the smallest feature in the mesher's space, in m."""
    lengths = [layout.gap + space.moved[2] - space.moved[1], layout.tube - layout.hole, layout.inner_height, layout.outer_height]
    if layout.groove is not None:
        lengths += [2 * layout.groove[0], layout.groove[1]]
    for body in layout.inclusions:
        scale = float(space.compute_scale(body.centre[None, :])[0])
        lengths += [
            (_INCLUSION_FEATURE_FRACTIONS[1] + scale * (_INCLUSION_FEATURE_FRACTIONS[0] - _INCLUSION_FEATURE_FRACTIONS[1]))
            * scale
            * body.min_semi_axis,
            2 * scale * float(-body.centre[2] - body.reach[2]),
        ]
    return min(length for length in lengths if length > 0)


def _tetrahedralize(
    points: Points,
    triangles: NDArray[np.int32],
    envelope: float,
    sizes: tuple[Points, NDArray[np.int32], Points],
    patience: float,
) -> tuple[Points, NDArray[np.int64]]:
    """Call pytetwild; ``envelope`` in m, ``sizes`` as from ``build_background``, ``patience`` in s."""
    scale = 1 / float(np.linalg.norm(np.ptp(points, axis=0)))
    grid, cells, values = sizes
    values = np.minimum(values, _MAX_RELATIVE_SIZE / scale)
    arguments: Arrays = {
        "vertices": points * scale,
        "faces": triangles,
        "edge_length_abs": np.array(float(values.max()) * scale),
        "epsilon": np.array(envelope * scale),
        "disable_filtering": np.array(True),
        "num_opt_iter": np.array(_TETWILD_MAX_ITERATIONS),
        "stop_energy": np.array(_TETWILD_STOP_ENERGY),
        "bg_vertices": grid * scale,
        "bg_tets": cells,
        "bg_values": values * scale,
    }
    nodes, tetrahedra = tetrahedralize(arguments, patience)
    return nodes / scale, tetrahedra


def _finish_mesh(layout: BodyLayout, space: MeshSpace, turns: Corners, nodes: Points, tetrahedra: NDArray[np.int64]) -> TetMesh:
    """Label tetrahedra, move nodes to the exact surfaces, improve and curve elements, and drop those outside."""
    points = space.to_scene(nodes)
    body, is_beyond = label_points(layout, turns, space, space.to_scene(nodes[tetrahedra].mean(axis=1)))
    exact = build_exact_surfaces(layout)
    faces, first_body, second_body = find_interfaces(tetrahedra, body)
    on_bodies = np.maximum(first_body, second_body) >= 0
    faces, chosen = (
        faces[on_bodies],
        find_surfaces(exact, points, faces[on_bodies], first_body[on_bodies], second_body[on_bodies]),
    )
    if (chosen < 0).any():
        a, b = first_body[on_bodies][chosen < 0][0], second_body[on_bodies][chosen < 0][0]
        raise SolveError(f"volume mesh: bodies {a} and {b} touch, which they do not in the scene")
    body, faces, chosen = remove_slivers(exact, points, tetrahedra, body=body, faces=faces, chosen=chosen)
    member = find_memberships(len(points), faces, chosen, len(exact))
    used = body >= 0
    vertices, number = np.unique(tetrahedra[used], return_inverse=True)
    renumber = np.full(len(points), -1)
    renumber[vertices] = np.arange(len(vertices))
    cells, member, faces = number.reshape(-1, 4), member[vertices], renumber[faces]
    straight = smooth(snap(exact, points[vertices], member), cells, exact, member, min_ratio=_MEND_BELOW_RATIO, rounds=6)
    straight = undo_inversions(straight, snap_to_permanent(exact, points[vertices], member), cells, _MIN_MENDED_RATIO)
    body, is_beyond, layer = body[used], is_beyond[used], np.zeros(len(cells), dtype=np.int64)
    if layout.interfaces:
        cut = cut_by_planes(layout, exact, straight, cells, body=body, member=member)
        straight, cells, faces, chosen, layer = cut.points, cut.cells, cut.faces, cut.chosen, cut.layer
        body, is_beyond = body[cut.parent], is_beyond[cut.parent]
    quadratic, elements = curve_mesh(straight, cells, exact, faces=faces, chosen=chosen, keep=_MIN_KEPT_QUALITY)
    return TetMesh(quadratic, elements, body, is_beyond, np.where(body < TISSUE_BODY, 0, layer), layout.half)
