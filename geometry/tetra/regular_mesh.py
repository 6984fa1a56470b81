"""Mesh regular scenes by netgen, which meshes blocks, groove, tissue, its layers and ellipsoids as exact shapes.

No stretched space is needed: the gap is air, which is not meshed. Bodies from files, whose triangles are no such shapes, and
hairline gaps are left to pytetwild.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points
from geometry.common.errors import SolveError
from geometry.mesh_programs.glued_shapes import GluedShapes, Pieces
from geometry.mesh_programs.size_cubes import SizeCubes, build_size_cubes
from geometry.tetra.body_layout import BodyLayout, Ellipsoid
from geometry.tetra.labels import label_points
from geometry.tetra.layers import find_body_faces, find_layers
from geometry.tetra.sizing import TetraFineness, compute_sizes, count_squares
from geometry.tetra.smoothing import smooth
from geometry.tetra.snapping import build_exact_surfaces, curve_mesh, find_memberships, snap
from geometry.tetra.stretched_space import MeshSpace
from geometry.tetra.surfaces import Corners, choose_corners
from geometry.tetra.tet_mesh import TISSUE_BODY, TetMesh

Indices = NDArray[np.int64]
_TETRAHEDRA_PER_CUBE = 6 * 2**0.5  # regular tetrahedra in the cube of their edge
_TETRAHEDRA_PER_SQUARE = 5.0  # tetrahedra that a thin layer has in a square of their edge
_GRADING_FACTOR = 1.3  # times our sizes' growth: netgen's own, between the points where they are told
_SMOOTHING_ROUNDS = 3  # rounds: a fifth fewer tetrahedra than after one, which saves more than they take
_MIN_RELATIVE_GAP = 1 / 300  # of the solid cylinder's radius: below half of that netgen never ends on the strip under the gap
_MEND_BELOW_RATIO = 0.2  # straight tetrahedra below this mean ratio are mended
_MIN_KEPT_QUALITY = 0.2  # of its quality an element keeps when its edges are curved, or they stay straight
_MIN_VOLUME_FRACTION = 0.9  # of a piece's volume that lies in one body, as tetrahedra are straight and bodies are not


def is_regular(layout: BodyLayout) -> bool:
    """Return whether all bodies are shapes with formulas, and the gap no hairline."""
    return layout.gap >= _MIN_RELATIVE_GAP * layout.inner and all(isinstance(body, Ellipsoid) for body in layout.inclusions)


def mesh_regular_layout(layout: BodyLayout, fineness: TetraFineness, space: MeshSpace, patience: float) -> TetMesh:
    """Mesh a regular layout; ``space`` says how sizes grow far away, ``patience`` is in s.

    Raises
    ------
    TooLong, Failure, KeyboardInterrupt
        See ``geometry.processes.programs.run_program``.
    SolveError
        A piece is in no body, or in two.
    """
    pieces = build_shapes(layout, fineness, space).mesh(patience)
    body, is_beyond, layer = _label_pieces(layout, space, choose_corners(layout, fineness.corners), pieces)
    surfaces = build_exact_surfaces(layout)
    faces, chosen = find_body_faces(layout, surfaces, pieces.points, pieces.tetrahedra, body=body, layer=layer)
    member = find_memberships(len(pieces.points), faces, chosen, len(surfaces))
    exact = snap(surfaces, pieces.points, member)
    straight = smooth(exact, pieces.tetrahedra, surfaces, member, min_ratio=_MEND_BELOW_RATIO, rounds=6)
    nodes, elements = curve_mesh(straight, pieces.tetrahedra, surfaces, faces=faces, chosen=chosen, keep=_MIN_KEPT_QUALITY)
    return TetMesh(nodes, elements, body, is_beyond, layer, layout.half)


def build_shapes(layout: BodyLayout, fineness: TetraFineness, space: MeshSpace) -> GluedShapes:
    """Build the scene's bodies as shapes, and the sizes wanted."""
    cylinders: list[tuple[float, ...]] = [(0.0, 0.0, 0.0, layout.inner_height, layout.inner)]
    (x, y), (a, b), floor = layout.centre, layout.sides, -layout.depth
    if layout.wall is not None:
        cylinders.append((0.0, 0.0, floor, 0.0, layout.wall))
    round_tissue = layout.tissue_radius is not None
    if layout.tissue_radius is not None:
        cylinders.append((x, y, floor, 0.0, layout.tissue_radius))
    grooves, cubes = [], _build_cubes(layout, fineness, space)
    if layout.groove is not None:
        width, depth = layout.groove
        grooves = [(0.0, -width, layout.outer_height - depth, 2 * layout.tube, width, layout.outer_height)]
    return GluedShapes(
        cylinders=np.array(cylinders),
        tubes=np.array([(0.0, 0.0, 0.0, layout.outer_height, layout.hole, layout.tube)]),
        boxes=np.array([] if round_tissue else [(x - a, y - b, floor, x + a, y + b, 0.0)]).reshape(-1, 6),
        grooves=np.array(grooves).reshape(-1, 6),
        ellipsoids=np.array([[*body.centre, *body.axes.ravel()] for body in _list_ellipsoids(layout)]).reshape(-1, 12),
        cuts=np.array(layout.interfaces, dtype=np.float64),
        half=layout.half,
        sizes=np.column_stack([cubes.middles, cubes.sizes]),
        grading=min(1.0, _GRADING_FACTOR * fineness.growth),
        smoothing=_SMOOTHING_ROUNDS,
    )


def _list_ellipsoids(layout: BodyLayout) -> list[Ellipsoid]:
    return [body for body in layout.inclusions if isinstance(body, Ellipsoid)]


def estimate_regular_elements(layout: BodyLayout, fineness: TetraFineness, space: MeshSpace) -> float:
    """Return about how many tetrahedra a regular layout's mesh will have, from their sizes alone: 0.8 to 1.5 times as many."""
    cubes = _build_cubes(layout, fineness, space)
    whole = _TETRAHEDRA_PER_CUBE * ((cubes.edges / cubes.sizes) ** 3)[layout.contains(cubes.middles)].sum()
    return float(whole + _TETRAHEDRA_PER_SQUARE * count_squares(layout, fineness, space))


def _build_cubes(layout: BodyLayout, fineness: TetraFineness, space: MeshSpace) -> SizeCubes:
    top = max(layout.inner_height, layout.outer_height)
    wide = max(float(layout.compute_side_distance(np.linspace(0, 2 * np.pi, 721)).max()), (layout.depth + top) / 2)

    def is_near(points: Points, distance: float) -> NDArray[np.bool_]:
        radius, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
        side = layout.compute_side_distance(np.arctan2(points[:, 1], points[:, 0]))
        tissue = (z < distance) & (z > -layout.depth - distance) & (radius < side + distance)
        blocks = (z > -distance) & (z < top + distance) & (radius < layout.tube + distance)
        return np.asarray((tissue | blocks) & ((points[:, 1] > -distance) | (not layout.half)))

    def find_sizes(points: Points) -> Points:
        return compute_sizes(layout, fineness, space, points)

    return build_size_cubes(find_sizes, is_near, centre=np.array([0.0, 0.0, top - wide]), edge=2 * wide)


def _label_pieces(
    layout: BodyLayout, space: MeshSpace, turns: Corners, pieces: Pieces
) -> tuple[Indices, NDArray[np.bool_], Indices]:
    """Return body, whether beyond the reference cylinder, and layer of each tetrahedron, by majority of its piece's volume."""
    corners = pieces.points[pieces.tetrahedra]
    centres, volumes = corners.mean(axis=1), np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    body, is_beyond = label_points(layout, turns, space, centres)
    layer = np.where(body < TISSUE_BODY, 0, find_layers(layout, centres[:, 2]))
    kinds, number = np.unique(np.column_stack([body, is_beyond, layer]), axis=0, return_inverse=True)
    votes = np.zeros((int(pieces.piece.max()) + 1, len(kinds)))
    np.add.at(votes, (pieces.piece, number.reshape(-1)), volumes)
    winner = votes.argmax(axis=1)
    unsure = votes.max(axis=1) < _MIN_VOLUME_FRACTION * votes.sum(axis=1)
    if unsure.any() or (kinds[winner, 0] < 0).any():
        raise SolveError("volume mesh: a piece of netgen's mesh lies in no body or in two")
    chosen = kinds[winner[pieces.piece]]
    return chosen[:, 0], chosen[:, 1].astype(bool), chosen[:, 2]
