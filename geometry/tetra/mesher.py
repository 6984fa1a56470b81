"""From a scene to a mesh of quadratic tetrahedra labelled by body: by netgen, or surfaces, pytetwild, exact surfaces; checks.

pytetwild is called once for all surfaces, in a space where the gap is wide and far tissue near
(``geometry.tetra.stretched_space``). A mesh that fails the checks is made again, finer; one that fails still is refused,
never used.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.cad.decimation import FEW, MANY
from geometry.common.arrays import Points
from geometry.common.child_process import Failure, TooLong
from geometry.common.errors import SolveError
from geometry.common.resources import check_time
from geometry.mesh_programs.tetwild import tetrahedralize
from geometry.tetra.check import check, largest_error
from geometry.tetra.facets import halved
from geometry.tetra.labels import labels
from geometry.tetra.layers import layered
from geometry.tetra.layout import BodyLayout
from geometry.tetra.regular_mesh import is_regular, regular_elements, regular_mesh
from geometry.tetra.sizing import COARSE, FINE, ROUGH, TetraFineness, background, squares
from geometry.tetra.smoothing import remove_slivers, smooth, undo_inversions
from geometry.tetra.snapping import curved_mesh, exact_surfaces, interfaces, memberships, snap, snap_to_permanent, surfaces_of
from geometry.tetra.stretched_space import MeshSpace, mesh_space
from geometry.tetra.surface_files import Sheet
from geometry.tetra.surfaces import Corners, corners, surfaces
from geometry.tetra.tet_mesh import TISSUE, TetMesh

__all__ = ["COARSE", "FINE", "ROUGH", "TetraFineness", "Timing", "expected_elements", "mesh_layout"]

_NEAR = 1.7  # far tissue begins at this many times the probe's largest length
_ENVELOPE = 0.15  # of the smallest feature: how far pytetwild's surfaces may be from the given ones; never above half the gap
_DRAWN = 0.25  # of the envelope: how far fewer triangles may be from a surface that they stand for
_NARROW = 0.5, 0.7  # of an inclusion's least semi-axis, near the probe and far from it: what counts as a feature
_WIDEN = 12  # the gap becomes wider by this factor at most: tetrahedra below it are squeezed as much on the way back
_RISE = 1.0  # how much faster the gap becomes wider upwards than the tetrahedra become larger
_LEAST_RATIO = 0.2  # straight tetrahedra below this mean ratio are mended
_LEAST_KEPT = 0.05  # those that stay below this are put back to where pytetwild had them, off all but the outer planes
_KEEP = 0.2  # of its quality an element keeps when its edges are curved, or they stay straight
_TRIALS = 3
_PATIENCE = 240.0, 600.0, 600.0  # s for pytetwild in each: no two runs are alike, and one in many never ends
_QUICK, _SLOW = 30.0, 500.0  # s for netgen, and tetrahedra in a second beyond: it makes some 6000
_TIGHTER = 0.7  # the envelope from trial to trial: pytetwild's time goes with its square
_GOOD = 3e-3  # error of a block's or ellipsoid's volume above which another trial is made
_ITERATIONS = 25  # of pytetwild: where these do not do, more hardly help
_ENERGY = 10.0  # of pytetwild: quality at which it stops
_LARGEST = 0.1  # of all surfaces' extent: tetrahedra above it cost, as pytetwild fills a box that is larger by as much
_ROWS = 12  # of quadrilaterals down the tissue's side
_MARGIN = 0.15  # of the box's diagonal: by how much the sizes' field is larger than the surfaces
_PER_EDGE = 6 * 2**0.5  # regular tetrahedra in the cube of their edge
_PER_SQUARE = 11.0  # tetrahedra that a plane adds by cutting a square of their edge


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

    Returns:
        Of the meshes that passed the checks that with the least error of volume, and how long all trials took.

    Raises:
        SolveError: none passed, or pytetwild took longer than its limit twice; the text says why.
        LimitReached: the time is over before there is a mesh.
        KeyboardInterrupt: Ctrl-C, at once.
    """
    if is_regular(layout):
        with suppress(SolveError):
            return _tried(layout, fineness, NETGEN)
    return _tried(layout, fineness, TETWILD)


def _tried(layout: BodyLayout, fineness: TetraFineness, mesher: Mesher) -> tuple[TetMesh, Timing]:
    """Mesh a layout; again, finer, where a mesh fails the checks or a volume is off by more than 0.3 %; see ``mesh_layout``."""
    fault, best, least = "", None, np.inf
    trials, start = 0, time.perf_counter()
    while trials < _TRIALS and least > _GOOD:
        try:
            mesh = mesher.trial(layout, fineness, trials)
            check(mesh, layout)
            if (off := largest_error(mesh, layout)) < least:
                best, least = mesh, off
        except TooLong as failure:
            if best is None:
                check_time(_work(layout))
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


def _work(layout: BodyLayout) -> str:
    """Describe the work that takes long, and what would shorten it."""
    uneven = [len(body.triangles) for body in layout.inclusions if isinstance(body, Sheet) and body.fewer is None]
    if max(uneven, default=0) <= MANY:
        return "meshing"
    return f"meshing a surface of {max(uneven)} triangles too uneven to be followed by {FEW} (a smoother one takes less)"


def expected_elements(layout: BodyLayout, fineness: TetraFineness) -> float:
    """Return about how many tetrahedra a layout's mesh will have, from their sizes alone, in a moment.

    See ``estimate_regular_elements`` for netgen. Of pytetwild meshes with 5000 to 250 000 tetrahedra they are 0.97 to 1.6 x as
    many, large ones nearer to 1; what planes between layers add is 1 to 1.8 times as many.
    """
    if is_regular(layout):
        return regular_elements(layout, fineness, space_of(layout, fineness))
    space, _, soup, sizes = _prepared(layout, fineness)
    grid, cells, values = sizes[0], sizes[1], np.minimum(sizes[2], _LARGEST * float(np.linalg.norm(np.ptp(soup[0], axis=0))))
    corners = grid[cells]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    inside = layout.holds(space.to_scene(corners.mean(axis=1)))
    whole = float(_PER_EDGE * (volume / values[cells].mean(axis=1) ** 3)[inside].sum())
    return whole + _PER_SQUARE * squares(layout, fineness, space)


def _prepared(
    layout: BodyLayout, fineness: TetraFineness
) -> tuple[MeshSpace, Corners, tuple[Points, NDArray[np.int32]], tuple[Points, NDArray[np.int32], Points]]:
    """Return the mesher's space, the polygons that stand for circles, surfaces in that space, and the sizes wanted there."""
    space, turns = space_of(layout, fineness), corners(layout, fineness.corners)
    layout = _drawn(layout, space)
    coarse = surfaces(layout, turns, space.near, _ROWS, max(5, round(2.5 / fineness.sphere)))
    points, triangles = _in_mesh_space(layout, space, halved(*coarse, layout, fineness, space))
    box = np.array([points.min(axis=0), points.max(axis=0)])
    margin = _MARGIN * float(np.linalg.norm(box[1] - box[0]))
    return space, turns, (points, triangles), background(layout, fineness, space, box + np.array([[-margin], [margin]]))


def _by_netgen(layout: BodyLayout, fineness: TetraFineness, trial: int) -> TetMesh:
    """Mesh a layout by netgen; a later trial differs by its slightly smaller sizes."""
    return regular_mesh(layout, fineness, space_of(layout, fineness), _QUICK + expected_elements(layout, fineness) / _SLOW)


def _by_tetwild(layout: BodyLayout, fineness: TetraFineness, trial: int) -> TetMesh:
    """Mesh a layout by pytetwild, with a tighter envelope at each trial."""
    space, turns, (points, triangles), sizes = _prepared(layout, fineness)
    envelope = _ENVELOPE * _TIGHTER**trial * _smallest(layout, space)
    return _finish(layout, space, turns, *_tetrahedralize(points, triangles, envelope, sizes, _PATIENCE[trial]))


NETGEN, TETWILD = Mesher("netgen", _by_netgen), Mesher("pytetwild", _by_tetwild)


def space_of(layout: BodyLayout, fineness: TetraFineness) -> MeshSpace:
    """Choose mesher's space: a gap as wide as tetrahedra at its rims, tissue beyond the probe and surface files drawn near."""
    sheets = [float(np.linalg.norm(body.points, axis=1).max()) for body in layout.inclusions if isinstance(body, Sheet)]
    near = max(_NEAR * max(layout.tube, layout.inner_height, layout.outer_height), *(1.05 * size for size in sheets), 0.0)
    wide = min(fineness.rim * layout.inner, _WIDEN * layout.gap)
    height = max(layout.inner_height, layout.outer_height)
    return mesh_space(
        layout.inner, layout.hole, layout.tube, gap=wide, near=near, height=height, rise=_RISE * fineness.growth * height
    )


def _drawn(layout: BodyLayout, space: MeshSpace) -> BodyLayout:
    """Return the layout with fewer triangles for surfaces of very many, where these stay well within the envelope.

    pytetwild alone is given these: labels, nodes and checks go by the file's own triangles.
    """
    allowed = _DRAWN * _ENVELOPE * _smallest(layout, space)
    bodies = (body.fewer if isinstance(body, Sheet) and body.off <= allowed else None for body in layout.inclusions)
    return replace(layout, inclusions=tuple(few or own for few, own in zip(bodies, layout.inclusions, strict=True)))


def _in_mesh_space(layout: BodyLayout, space: MeshSpace, soup: tuple[Points, Any]) -> tuple[Points, NDArray[np.int32]]:
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


def _smallest(layout: BodyLayout, space: MeshSpace) -> float:
    """Return the smallest feature in the mesher's space, in m."""
    lengths = [layout.gap + space.moved[2] - space.moved[1], layout.tube - layout.hole, layout.inner_height, layout.outer_height]
    if layout.groove is not None:
        lengths += [2 * layout.groove[0], layout.groove[1]]
    for body in layout.inclusions:
        scale = float(space.scale(body.centre[None, :])[0])
        lengths += [
            (_NARROW[1] + scale * (_NARROW[0] - _NARROW[1])) * scale * body.smallest,
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
    values = np.minimum(values, _LARGEST / scale)
    arguments: dict[str, NDArray[Any]] = {
        "vertices": points * scale,
        "faces": triangles,
        "edge_length_abs": np.array(float(values.max()) * scale),
        "epsilon": np.array(envelope * scale),
        "disable_filtering": np.array(True),
        "num_opt_iter": np.array(_ITERATIONS),
        "stop_energy": np.array(_ENERGY),
        "bg_vertices": grid * scale,
        "bg_tets": cells,
        "bg_values": values * scale,
    }
    nodes, tetrahedra = tetrahedralize(arguments, patience)
    return nodes / scale, tetrahedra


def _finish(layout: BodyLayout, space: MeshSpace, turns: Corners, nodes: Points, tetrahedra: NDArray[np.int64]) -> TetMesh:
    """Label, move to the exact surfaces, mend, curve, and drop what is outside."""
    points = space.to_scene(nodes)
    body, beyond = labels(layout, turns, space, space.to_scene(nodes[tetrahedra].mean(axis=1)))
    exact = exact_surfaces(layout)
    faces, one, other = interfaces(tetrahedra, body)
    on_bodies = np.maximum(one, other) >= 0
    faces, chosen = faces[on_bodies], surfaces_of(exact, points, faces[on_bodies], one[on_bodies], other[on_bodies])
    if (chosen < 0).any():
        a, b = one[on_bodies][chosen < 0][0], other[on_bodies][chosen < 0][0]
        raise SolveError(f"volume mesh: bodies {a} and {b} touch, which they do not in the scene")
    body, faces, chosen = remove_slivers(exact, points, tetrahedra, body=body, faces=faces, chosen=chosen)
    member = memberships(len(points), faces, chosen, len(exact))
    used = body >= 0
    vertices, number = np.unique(tetrahedra[used], return_inverse=True)
    renumber = np.full(len(points), -1)
    renumber[vertices] = np.arange(len(vertices))
    cells, member, faces = number.reshape(-1, 4), member[vertices], renumber[faces]
    straight = smooth(snap(exact, points[vertices], member), cells, exact, member, least=_LEAST_RATIO, rounds=6)
    straight = undo_inversions(straight, snap_to_permanent(exact, points[vertices], member), cells, _LEAST_KEPT)
    body, beyond, layer = body[used], beyond[used], np.zeros(len(cells), dtype=np.int64)
    if layout.interfaces:
        cut = layered(layout, exact, straight, cells, body=body, member=member)
        straight, cells, faces, chosen, layer = cut.points, cut.cells, cut.faces, cut.chosen, cut.layer
        body, beyond = body[cut.parent], beyond[cut.parent]
    quadratic, elements = curved_mesh(straight, cells, exact, faces=faces, chosen=chosen, keep=_KEEP)
    return TetMesh(quadratic, elements, body, beyond, np.where(body < TISSUE, 0, layer), layout.half)
