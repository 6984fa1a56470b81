"""Mesh blocks, groove, tissue, its layers and ellipsoids by netgen, as exact shapes.

No stretched space is needed: the gap is air, which is not meshed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points
from geometry.common.errors import SolveError
from geometry.mesh_programs.glued_shapes import GluedShapes
from geometry.mesh_programs.size_cubes import SizeCubes, build_size_cubes
from geometry.tetra.body_layout import BodyLayout, Ellipsoid
from geometry.tetra.layers import find_body_faces, find_layers
from geometry.tetra.sizing import TetraFineness, choose_space, compute_sizes, count_squares
from geometry.tetra.smoothing import smooth
from geometry.tetra.snapping import build_exact_surfaces, curve_mesh, find_memberships, snap
from geometry.tetra.stretched_space import choose_mesh_space
from geometry.tetra.tet_mesh import MeshBody, TetMesh

Indices = NDArray[np.int64]
_TETRAHEDRA_PER_CUBE = 6 * 2**0.5  # regular tetrahedra in the cube of their edge
_GRADING_FACTOR = 1.3  # times our sizes' growth: netgen's own, between the points where they are given
_SMOOTHING_ROUNDS = 3  # rounds: a fifth fewer tetrahedra than after one, which saves more than they take
_CURVATURE_SAFETY = 2.0  # radius of curvature over edge length: with 1.3 some elements stay straight, and volumes err by percents
MIN_RELATIVE_GAP = 1 / 300  # of the solid cylinder's radius: below half of that netgen never ends on the strip under the gap
_MIN_TIME_S, _MIN_TETRAHEDRA_PER_S = 30.0, 500.0  # netgen's time limit: this, and more for each tetrahedron; it makes some 6000/s
_MEND_BELOW_RATIO = 0.2  # straight tetrahedra below this mean ratio are mended
_MIN_KEPT_QUALITY = 0.2  # of its quality an element keeps when its edges are curved, or they stay straight
_MIN_VOLUME_FRACTION = 0.9  # of a piece's volume that lies in one body, as tetrahedra are straight and bodies are not


@dataclass(frozen=True)
class LabelledTetrahedra:
    """Straight tetrahedra of blocks, groove, tissue and ellipsoids; surfaces from files left out.

    Attributes
    ----------
    points
        (n, 3) in m.
    cells
        (t, 4).
    body, beyond, layer
        Of each tetrahedron, as in ``TetMesh``.
    """

    points: Points
    cells: Indices
    body: Indices
    beyond: NDArray[np.bool_]
    layer: Indices


def mesh_regular_layout(layout: BodyLayout, fineness: TetraFineness) -> TetMesh:
    """Mesh a layout without surfaces from files; raises as ``mesh_shapes``, and ``SolveError`` where bodies touch wrongly."""
    straight = mesh_shapes(layout, fineness)
    surfaces = build_exact_surfaces(layout)
    faces, chosen = find_body_faces(layout, surfaces, straight.points, straight.cells, body=straight.body, layer=straight.layer)
    member = find_memberships(len(straight.points), faces, chosen, len(surfaces))
    exact = snap(surfaces, straight.points, member)
    mended = smooth(exact, straight.cells, surfaces, member, min_ratio=_MEND_BELOW_RATIO, rounds=6)
    nodes, elements = curve_mesh(mended, straight.cells, surfaces, faces=faces, chosen=chosen, keep=_MIN_KEPT_QUALITY)
    return TetMesh(nodes, elements, straight.body, straight.beyond, straight.layer, layout.half)


def mesh_shapes(layout: BodyLayout, fineness: TetraFineness, curvature_safety: float = _CURVATURE_SAFETY) -> LabelledTetrahedra:
    """Mesh all bodies that are shapes by netgen, and label its tetrahedra.

    A hairline gap is widened for netgen and narrowed again, which leaves good surfaces, but flat tetrahedra below the gap.

    Raises
    ------
    TooLong, Failure, KeyboardInterrupt
        See ``geometry.processes.programs.run_program``.
    SolveError
        A piece is in no body, or in two.
    """
    widening = choose_mesh_space(
        layout.inner, layout.hole, layout.tube, gap=MIN_RELATIVE_GAP * layout.inner, linear_radius=math.inf
    )
    wide = replace(layout, inner=layout.inner + widening.moved[1], hole=layout.hole + widening.moved[2])
    patience = _MIN_TIME_S + _count_tetrahedra(_build_cubes(wide, fineness), layout) / _MIN_TETRAHEDRA_PER_S
    pieces = replace(build_shapes(wide, fineness), curvature_safety=curvature_safety).mesh(patience)
    corners = pieces.points[pieces.tetrahedra]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    labels = _choose_by_majority(pieces.piece, label_points(wide, corners.mean(axis=1)), volumes)
    body, layer = labels[:, 0], labels[:, 2]
    return LabelledTetrahedra(widening.to_scene(pieces.points), pieces.tetrahedra, body, labels[:, 1].astype(bool), layer)


def build_shapes(layout: BodyLayout, fineness: TetraFineness) -> GluedShapes:
    """Return a layout's bodies as shapes for netgen, with the wanted sizes; surfaces from files are left out."""
    cylinders: list[tuple[float, ...]] = [(0.0, 0.0, 0.0, layout.inner_height, layout.inner)]
    (x, y), (a, b), floor = layout.centre, layout.sides, -layout.depth
    if layout.wall is not None:
        cylinders.append((0.0, 0.0, floor, 0.0, layout.wall))
    boxes, grooves = [], []
    if layout.tissue_radius is not None:
        cylinders.append((x, y, floor, 0.0, layout.tissue_radius))
    else:
        boxes.append((x - a, y - b, floor, x + a, y + b, 0.0))
    if layout.groove is not None:
        width, depth = layout.groove
        grooves.append((0.0, -width, layout.outer_height - depth, 2 * layout.tube, width, layout.outer_height))
    ellipsoids = [[*body.centre, *body.axes.ravel()] for body in layout.inclusions if isinstance(body, Ellipsoid)]
    cubes = _build_cubes(layout, fineness)
    return GluedShapes(
        cylinders=np.array(cylinders),
        tubes=np.array([(0.0, 0.0, 0.0, layout.outer_height, layout.hole, layout.tube)]),
        boxes=np.array(boxes).reshape(-1, 6),
        grooves=np.array(grooves).reshape(-1, 6),
        ellipsoids=np.array(ellipsoids).reshape(-1, 12),
        cuts=np.array(layout.interfaces, dtype=np.float64),
        half=layout.half,
        sizes=np.column_stack([cubes.middles, cubes.sizes]),
        grading=min(1.0, _GRADING_FACTOR * fineness.growth),
        smoothing=_SMOOTHING_ROUNDS,
        curvature_safety=_CURVATURE_SAFETY,
    )


def estimate_tetrahedra(layout: BodyLayout, fineness: TetraFineness, per_square: float) -> float:
    """Return about how many tetrahedra a mesh will have, from their sizes alone.

    ``per_square`` tetrahedra are counted for each square of their edge that the planes between layers have.
    """
    volume_count = _count_tetrahedra(_build_cubes(layout, fineness), layout)
    return volume_count + per_square * count_squares(layout, fineness, choose_space(layout, fineness))


def _count_tetrahedra(cubes: SizeCubes, layout: BodyLayout) -> float:
    """Return about how many tetrahedra of the cubes' sizes fill the bodies, layers left out."""
    return float(_TETRAHEDRA_PER_CUBE * ((cubes.edges / cubes.sizes) ** 3)[layout.contains(cubes.middles)].sum())


def _build_cubes(layout: BodyLayout, fineness: TetraFineness) -> SizeCubes:
    """Return the field of wanted sizes in a layout's bodies, as cubes."""
    space, top = choose_space(layout, fineness), max(layout.inner_height, layout.outer_height)
    wide = max(float(layout.compute_side_distance(np.linspace(0, 2 * np.pi, 721)).max()), (layout.depth + top) / 2)

    def is_near(points: Points, distance: float) -> NDArray[np.bool_]:
        """Return which points (n, 3) lie in tissue or blocks, or about ``distance`` from them."""
        radius, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
        side = layout.compute_side_distance(np.arctan2(points[:, 1], points[:, 0]))
        tissue = (z < distance) & (z > -layout.depth - distance) & (radius < side + distance)
        blocks = (z > -distance) & (z < top + distance) & (radius < layout.tube + distance)
        return np.asarray((tissue | blocks) & ((points[:, 1] > -distance) | (not layout.half)))

    def find_sizes(points: Points) -> Points:
        """Return the wanted edge lengths at points (n, 3)."""
        return compute_sizes(layout, fineness, space, points)

    return build_size_cubes(find_sizes, is_near, centre=np.array([0.0, 0.0, top - wide]), edge=2 * wide)


def label_points(layout: BodyLayout, points: Points) -> Indices:
    """Return three labels of points (n, 3), (n, 3): the body, whether it is outside the reference cylinder, and the layer.

    The body may be ``MeshBody.AIR`` or ``MeshBody.MIRROR``; layers are as in ``TetMesh``.

    Surfaces from files are left out: what is inside them counts as the tissue or ellipsoid about them.
    """
    x, y, z = points.T
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    body = np.full(len(points), MeshBody.AIR)
    body[(z > 0) & (z < layout.inner_height) & (radius < layout.inner)] = MeshBody.INNER
    outer = (z > 0) & (z < layout.outer_height) & (radius >= layout.hole) & (radius < layout.tube)
    body[outer] = MeshBody.OUTER
    if layout.groove is not None:
        width, depth = layout.groove
        body[outer & (z > layout.outer_height - depth) & (x > 0) & (np.abs(y) < width)] = MeshBody.GROOVE
    tissue = (z < 0) & (z > -layout.depth) & (radius < layout.compute_side_distance(angle))
    body[tissue] = MeshBody.TISSUE
    is_beyond = tissue & (radius > (np.inf if layout.wall is None else layout.wall))
    body[is_beyond] = MeshBody.BEYOND
    for index, inclusion in enumerate(layout.inclusions):
        if isinstance(inclusion, Ellipsoid):
            body[tissue & (inclusion.level(points) < 1)] = MeshBody.FIRST_INCLUSION + index
    if layout.half:
        body[y < 0] = MeshBody.MIRROR
    return np.column_stack([body, is_beyond, np.where(body < MeshBody.TISSUE, 0, find_layers(layout, z))])


def _choose_by_majority(piece: Indices, labels: Indices, volumes: Points) -> Indices:
    """Return labels (t, k), for all tetrahedra of a piece those that most of its volume has.

    ``piece`` (t,) numbers the pieces; ``labels`` (t, k) and ``volumes`` (t,) are those of single tetrahedra.

    Raises
    ------
    SolveError
        Too little of a piece has the same labels, or most of it lies outside all bodies.
    """
    kinds, number = np.unique(labels, axis=0, return_inverse=True)
    votes = np.zeros((int(piece.max()) + 1, len(kinds)))
    np.add.at(votes, (piece, number.reshape(-1)), volumes)
    winner = votes.argmax(axis=1)
    is_unsure = votes.max(axis=1) < _MIN_VOLUME_FRACTION * votes.sum(axis=1)
    if is_unsure.any() or (kinds[winner, 0] < 0).any():
        raise SolveError("volume mesh: a piece of netgen's mesh lies in no body or in two")
    return np.asarray(kinds[winner[piece]])
