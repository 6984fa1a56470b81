"""Volume meshes of regular scenes: blocks, groove, tissue, its layers and ellipsoids are shapes that netgen meshes as they are.

It needs no stretched space: the gap is air, which is not meshed. Bodies from files, whose triangles are no such shapes, and
hairline gaps are left to pytetwild.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points
from geometry.common.errors import SolveError
from geometry.mesh_programs.glued_shapes import GluedShapes, Pieces
from geometry.mesh_programs.size_cubes import SizeCubes, size_cubes
from geometry.tetra.labels import labels
from geometry.tetra.layers import body_faces, layers_at
from geometry.tetra.layout import BodyLayout, Ellipsoid
from geometry.tetra.sizing import TetraFineness, sizes, squares
from geometry.tetra.smoothing import smooth
from geometry.tetra.snapping import curved_mesh, exact_surfaces, memberships, snap
from geometry.tetra.stretched_space import MeshSpace
from geometry.tetra.surfaces import Corners, corners
from geometry.tetra.tet_mesh import TISSUE, TetMesh

Indices = NDArray[np.int64]
_PER_CUBE = 6 * 2**0.5  # regular tetrahedra in the cube of their edge
_PER_SQUARE = 5.0  # tetrahedra that a thin layer has in a square of their edge
_STEEPER = 1.3  # times our sizes' growth: netgen's own, between the points where they are told
_SMOOTHING = 3  # rounds: a fifth fewer tetrahedra than after one, which saves more than they take
_HAIRLINE = 1 / 300  # of the solid cylinder's radius: below half of that netgen never ends on the strip under the gap
_LEAST_RATIO = 0.2  # straight tetrahedra below this mean ratio are mended
_KEEP = 0.2  # of its quality an element keeps when its edges are curved, or they stay straight
_SURE = 0.9  # of a piece's volume that lies in one body, as tetrahedra are straight and bodies are not


def is_regular(layout: BodyLayout) -> bool:
    """Return whether all bodies are shapes with formulas, and the gap no hairline."""
    return layout.gap >= _HAIRLINE * layout.inner and all(isinstance(body, Ellipsoid) for body in layout.inclusions)


def regular_mesh(layout: BodyLayout, fineness: TetraFineness, space: MeshSpace, patience: float) -> TetMesh:
    """Mesh a regular layout; ``space`` says how sizes grow far away, ``patience`` is in s.

    Raises:
        TooLong, Failure, KeyboardInterrupt: see ``geometry.common.child_process.run_program``.
        SolveError: a piece is in no body, or in two.
    """
    found = shapes(layout, fineness, space).meshed(patience)
    body, beyond, layer = _labelled(layout, space, corners(layout, fineness.corners), found)
    surfaces = exact_surfaces(layout)
    faces, chosen = body_faces(layout, surfaces, found.points, found.tetrahedra, body=body, layer=layer)
    member = memberships(len(found.points), faces, chosen, len(surfaces))
    exact = snap(surfaces, found.points, member)
    straight = smooth(exact, found.tetrahedra, surfaces, member, least=_LEAST_RATIO, rounds=6)
    nodes, elements = curved_mesh(straight, found.tetrahedra, surfaces, faces=faces, chosen=chosen, keep=_KEEP)
    return TetMesh(nodes, elements, body, beyond, layer, layout.half)


def shapes(layout: BodyLayout, fineness: TetraFineness, space: MeshSpace) -> GluedShapes:
    """Build the scene's bodies as shapes, and the sizes wanted."""
    cylinders: list[tuple[float, ...]] = [(0.0, 0.0, 0.0, layout.inner_height, layout.inner)]
    (x, y), (a, b), floor = layout.centre, layout.sides, -layout.depth
    if layout.wall is not None:
        cylinders.append((0.0, 0.0, floor, 0.0, layout.wall))
    round_tissue = layout.tissue_radius is not None
    if layout.tissue_radius is not None:
        cylinders.append((x, y, floor, 0.0, layout.tissue_radius))
    grooves, cubes = [], _cubes(layout, fineness, space)
    if layout.groove is not None:
        width, depth = layout.groove
        grooves = [(0.0, -width, layout.outer_height - depth, 2 * layout.tube, width, layout.outer_height)]
    return GluedShapes(
        cylinders=np.array(cylinders),
        tubes=np.array([(0.0, 0.0, 0.0, layout.outer_height, layout.hole, layout.tube)]),
        boxes=np.array([] if round_tissue else [(x - a, y - b, floor, x + a, y + b, 0.0)]).reshape(-1, 6),
        grooves=np.array(grooves).reshape(-1, 6),
        ellipsoids=np.array([[*body.centre, *body.axes.ravel()] for body in _ellipsoids(layout)]).reshape(-1, 12),
        cuts=np.array(layout.interfaces, dtype=np.float64),
        half=layout.half,
        sizes=np.column_stack([cubes.middles, cubes.sizes]),
        grading=min(1.0, _STEEPER * fineness.growth),
        smoothing=_SMOOTHING,
    )


def _ellipsoids(layout: BodyLayout) -> list[Ellipsoid]:
    return [body for body in layout.inclusions if isinstance(body, Ellipsoid)]


def regular_elements(layout: BodyLayout, fineness: TetraFineness, space: MeshSpace) -> float:
    """Return about how many tetrahedra a regular layout's mesh will have, from their sizes alone: 0.8 to 1.5 times as many."""
    cubes = _cubes(layout, fineness, space)
    whole = _PER_CUBE * ((cubes.edges / cubes.sizes) ** 3)[layout.holds(cubes.middles)].sum()
    return float(whole + _PER_SQUARE * squares(layout, fineness, space))


def _cubes(layout: BodyLayout, fineness: TetraFineness, space: MeshSpace) -> SizeCubes:
    top = max(layout.inner_height, layout.outer_height)
    wide = max(float(layout.side_distance(np.linspace(0, 2 * np.pi, 721)).max()), (layout.depth + top) / 2)

    def near(points: Points, within: float) -> NDArray[np.bool_]:
        radius, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
        side = layout.side_distance(np.arctan2(points[:, 1], points[:, 0]))
        tissue = (z < within) & (z > -layout.depth - within) & (radius < side + within)
        blocks = (z > -within) & (z < top + within) & (radius < layout.tube + within)
        return np.asarray((tissue | blocks) & ((points[:, 1] > -within) | (not layout.half)))

    def wanted(points: Points) -> Points:
        return sizes(layout, fineness, space, points)

    return size_cubes(wanted, near, centre=np.array([0.0, 0.0, top - wide]), edge=2 * wide)


def _labelled(layout: BodyLayout, space: MeshSpace, turns: Corners, found: Pieces) -> tuple[Indices, NDArray[np.bool_], Indices]:
    """Return body, whether beyond the reference cylinder, and layer of each tetrahedron, by majority of its piece's volume."""
    corners = found.points[found.tetrahedra]
    centres, volumes = corners.mean(axis=1), np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    body, beyond = labels(layout, turns, space, centres)
    layer = np.where(body < TISSUE, 0, layers_at(layout, centres[:, 2]))
    every, number = np.unique(np.column_stack([body, beyond, layer]), axis=0, return_inverse=True)
    votes = np.zeros((int(found.piece.max()) + 1, len(every)))
    np.add.at(votes, (found.piece, number.reshape(-1)), volumes)
    winner = votes.argmax(axis=1)
    unsure = votes.max(axis=1) < _SURE * votes.sum(axis=1)
    if unsure.any() or (every[winner, 0] < 0).any():
        raise SolveError("volume mesh: a piece of netgen's mesh lies in no body or in two")
    own = every[winner[found.piece]]
    return own[:, 0], own[:, 1].astype(bool), own[:, 2]
