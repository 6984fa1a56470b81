"""List the cells of a meridian mesh, and cut those at singular corners into geometric layers."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from itertools import accumulate, pairwise, product

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.crossed_sphere import Cap, CrossedBox
from geometry.meridian.mesh_lines import MeshTopology
from geometry.meridian.section import LAYERS, STACKS, Body
from geometry.meridian.stack_fineness import LAYER_RATIO

TENSOR, OUTSIDE, INSIDE, CORE, ARCH, STRIP = range(6)
UNIT_SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
Vertex = tuple[int, int]  # number of the radius, number of the level
Place = tuple[Vertex, bool] | None  # a corner: lines of the grid, and whether that on the sphere's surface is meant
Cell = tuple[int, Body, tuple[Vertex, ...], tuple[int, int]]  # shape, body, vertices, circles


def list_cells(layout: MeshTopology) -> Iterator[Cell]:
    """Yield all cells, before those at corners are cut."""
    column = layout.column
    yield from _list_tissue_cells(layout)
    inner, outer = range(column["inner"] + 1), range(column["hole"], column["tube"] + 1)
    blocks = ((Body.INNER, inner, layout.inner), (Body.OUTER, outer, layout.outer))
    for k, (block, radii, levels) in enumerate(blocks):
        ends = accumulate((0, layout.blocks[k], *layout.layer_rows[k]))
        for body, (first, last) in zip((block, *layout.kind.stacks[k]), pairwise(ends), strict=True):
            yield from _list_grid_cells(body, radii, levels[first : last + 1])
    if layout.kind.base is not None:
        yield from _list_base_cells(layout)


def _list_grid_cells(body: Body, radii: Sequence[int], levels: Sequence[int]) -> Iterator[Cell]:
    """Yield the rectangles of a body between neighbouring radii and neighbouring levels (numbers of lines)."""
    for (a, b), (c, d) in product(pairwise(radii), pairwise(levels)):
        yield TENSOR, body, ((a, c), (b, c), (b, d), (a, d)), (0, 0)


def _list_tissue_cells(layout: MeshTopology) -> Iterator[Cell]:
    """Yield the tissue's cells row by row from the surface, then the sphere with what is around it."""
    radii, low, high = list(range(layout.column["side"] + 1)), layout.row.get("low", 0), layout.row.get("high", 0)
    for top in range(layout.row["surface"], 0, -1):
        ended = {line for group in layout.merged.get(top, []) for line in group[1:-1]}
        for group in layout.merged.get(top, []):
            yield from _list_merging_cells(_find_layer(layout, top), group, top, layout.middles[top])
        first = layout.column["box"] if low < top <= high else 0
        for a, b in pairwise(radii):
            if a >= first and not {a, b} & ended:
                yield from _list_grid_cells(_find_layer(layout, top), (a, b), (top - 1, top))
        radii = [line for line in radii if line not in ended]
    if layout.box is not None:
        yield from _list_box_cells(layout, layout.box)


def _list_merging_cells(body: Body, columns: tuple[int, ...], top: int, middle: int) -> Iterator[Cell]:
    """Yield the four cells by which three columns become one: left, right, between and below."""
    a, b, c, d = columns
    floor = top - 1
    left, right = ((a, floor), (b, middle), (b, top), (a, top)), ((c, middle), (d, floor), (d, top), (c, top))
    between, below = ((b, middle), (c, middle), (c, top), (b, top)), ((a, floor), (d, floor), (c, middle), (b, middle))
    for vertices in (left, right, between, below):
        yield TENSOR, body, vertices, (0, 0)


def _find_layer(layout: MeshTopology, top: int) -> Body:
    """Return the body of the tissue's row below the level ``top`` (a number): a layer, or the tissue below all layers."""
    layer = sum(interface >= top for interface in layout.interfaces)
    return LAYERS[layer] if layer < len(layout.interfaces) else Body.TISSUE


def _list_box_cells(layout: MeshTopology, box: CrossedBox) -> Iterator[Cell]:
    """Yield the cells of the box: rings on its three sides (each counted so that cells are right-handed) and the core.

    Where interfaces cross the box, cells between columns follow.
    """
    edge, (lower, upper), lines = box.lines[-1], box.caps, box.lines
    low, high = lower.last, upper.last
    sides = [
        (_find_layer(layout, high), ((a, high), (b, high)) * 2, k >= max((0, *upper.starts)))
        for k, (a, b) in enumerate(pairwise(lines))
    ]
    sides += [(_find_layer(layout, d), ((edge, d), (edge, c)) * 2, True) for c, d in pairwise(range(low, high + 1))]
    sides += [
        (_find_layer(layout, low + 1), ((b, low), (a, low)) * 2, k >= max((0, *lower.starts)))
        for k, (a, b) in enumerate(pairwise(lines))
    ]
    for shape, count in zip((OUTSIDE, INSIDE), layout.rings, strict=True):
        for (body, side, free), circle in product(sides, range(count)):
            if shape == INSIDE or free:
                yield shape, body if shape == OUTSIDE else Body.INCLUSION, side, (circle, circle + 1)
    for _, body, vertices, circles in _list_grid_cells(Body.INCLUSION, lines, box.rows):
        yield CORE, body, vertices, circles
    for cap in box.caps:
        yield from _list_strip_cells(layout, lines, cap)


def _list_strip_cells(layout: MeshTopology, lines: Sequence[int], cap: Cap) -> Iterator[Cell]:
    """Yield the cells between a cap's columns, from the box's end to the first interface, and from each to the next.

    Above the cap they stand on the sphere (ARCH), beyond it on an interface (STRIP).
    """
    firsts, ends = (0, *cap.starts), (cap.end, *cap.rows)
    for k, (end, foot) in enumerate(pairwise(ends)):
        for (j, (a, b)), (c, d) in product(enumerate(pairwise(lines)), pairwise(range(min(foot, end), max(foot, end) + 1))):
            if j >= firsts[k]:
                shape = ARCH if j < firsts[k + 1] else STRIP
                yield shape, _find_layer(layout, d), ((a, c), (b, c), (b, d), (a, d)), (foot, end)


def _list_base_cells(layout: MeshTopology) -> Iterator[Cell]:
    """Yield the cells of an elastic base: boss, step and flange."""
    column, kind, middle = layout.column, layout.kind, len(layout.bridge) // 2
    inner = (*range(column["inner"]), *layout.bridge[: middle + 1])
    outer = (*layout.bridge[middle:], *range(column["hole"] + 1, column["tube"] + 1))
    if kind.base:
        yield from _list_grid_cells(Body.BASE, inner if kind.base < 0 else outer, layout.boss)
    yield from _list_grid_cells(Body.BASE, (*inner, *outer[1:]), layout.base)
    if kind.flange:
        yield from _list_grid_cells(Body.BASE, layout.flange, layout.base[layout.step :])


def list_singular_corners(layout: MeshTopology) -> Iterator[tuple[Place, int]]:
    """Yield the corners with singular stresses and how many layers cells have there.

    The blocks' corners, where interfaces meet the sphere, and where the side meets floor and interfaces.
    """
    layers = layout.fineness.layers
    column, surface = layout.column, layout.row["surface"]
    for radius, levels, rows in zip(
        ("inner", "hole", "tube"), (layout.inner, layout.outer, layout.outer), (0, 1, 1), strict=True
    ):
        yield ((column.get(f"{radius} edge", column[radius]), surface), False), layers
        for top in {levels[layout.blocks[rows]], levels[-1]}:  # of the block, and of the layers on it
            yield ((column[radius], top), False), layout.top_layers
    yield ((column["side"], layout.row["floor"]), False), layers
    for level, cut in zip(layout.interfaces, layout.kind.ends, strict=True):
        if cut:
            yield ((column["side"], level), False), layers
    if layout.kind.flange:
        yield ((column["tube"], layout.base[layout.step]), False), layers
    if layout.kind.base:
        yield ((layout.bridge[len(layout.bridge) // 2], layout.boss[-1]), False), layers
    if layout.box is None:
        return
    for level in layout.box.sides:
        yield ((column["box"], level), True), layers
    for cap in layout.box.caps:
        for start, level in zip(cap.starts, cap.rows, strict=True):
            line = layout.box.lines[start]
            max_layers = min(layers, layout.box.tips[line, level])
            yield ((line, cap.last), True), max_layers
            yield ((line, level), False), max_layers


def _find_wall_side(cell: Cell, layout: MeshTopology) -> int | None:
    """Return on which side, left (0) or right (1), a cell of a film or a bond ends at its block's wall; None for other cells."""
    _, body, vertices, _ = cell
    block = next((k for k, stack in enumerate(STACKS) if body in stack), None)
    walls = (None, layout.column["inner"]) if block == 0 else (layout.column["hole"], layout.column["tube"])
    ends = (vertices[0][0], vertices[1][0])
    return None if block is None else next((side for side in (0, 1) if ends[side] == walls[side]), None)


def _list_corners(cell: Cell, rings: int) -> Iterator[Place]:
    """Yield the ``Place`` of each of a cell's corners; None for one in the middle of a ring."""
    shape, _, vertices, circles = cell
    if shape in (TENSOR, ARCH, STRIP):
        yield from ((vertex, False) for vertex in vertices)
    elif shape != CORE:
        on_sphere = 0 if shape == OUTSIDE else rings
        for end, circle in zip((0, 1, 1, 0), np.repeat(circles, 2), strict=True):
            yield (vertices[end], True) if circle == on_sphere else None


def _find_point_side(cell: Cell, tips: Container[Vertex]) -> int | None:
    """Return which side of a cell, left (0) or right (1), is a point where an interface begins on the sphere near its pole."""
    shape, _, vertices, circles = cell
    if shape in (ARCH, STRIP):
        return 0 if (vertices[0][0], circles[1]) in tips else None
    return next((end for end in (0, 1) if vertices[end] in tips), None) if shape == OUTSIDE else None


def _cut_strips(side: int, layers: int, ratio: float = LAYER_RATIO) -> Floats:
    """Cut the unit square into upright strips, ever thinner towards its left (0) or right (1) side; shape (strips, 4, 2)."""
    ends = np.array([0.0, *(ratio**k for k in range(layers, -1, -1))])
    pieces = [UNIT_SQUARE * [high - low, 1.0] + [low, 0.0] for low, high in pairwise(np.sort(np.abs(side - ends)))]
    return np.stack(pieces)


def cut_layers(cell: Cell, layout: MeshTopology, singular: dict[Place, int], tips: dict[Vertex, int]) -> tuple[Cell, Floats]:
    """Cut a cell's unit square into geometric layers towards its singular corner, point or wall, if any; shape (elements, 4, 2).

    Films and bonds are thin, and singular at the wall where they end, see ``_cut_at_wall``.
    """
    wall = _find_wall_side(cell, layout)
    if wall is not None:
        return cell, _cut_at_wall(cell, layout, wall)
    point = _find_point_side(cell, tips)
    if point is not None:
        _, _, vertices, circles = cell
        tip = vertices[point] if vertices[point] in tips else (vertices[0][0], circles[1])
        return cell, _cut_strips(point, min(layout.fineness.layers, tips[tip]))
    corners = [(k, singular[place]) for k, place in enumerate(_list_corners(cell, layout.rings[1])) if place in singular]
    if not corners or not corners[0][1]:
        return cell, UNIT_SQUARE[None]
    ((k, layers),) = corners  # two cells at least lie between any two singular corners
    return cell, _cut_corner(k, layers, layout.top_ratio if cell[2][k][1] in layout.layer_ends else LAYER_RATIO)


def _cut_at_wall(cell: Cell, layout: MeshTopology, side: int) -> Floats:
    """Cut the cell of a film or a bond that ends at a wall on its left (0) or right (1) side; shape (elements, 4, 2).

    Cells are much wider than high: a layer of one row is cut into strips across its thickness. With more rows the last strip at
    the wall, about as wide as high, is cut further, towards the corner where the layer meets the next, where ``top_layers``
    is above ``wall_strips``.
    """
    layers, ratio, (_, _, vertices, _) = layout.top_layers, layout.top_ratio, cell
    low, high = vertices[0][1] in layout.layer_ends, vertices[3][1] in layout.layer_ends
    strips = layers if low and high else layout.wall_strips
    pieces, width = _cut_strips(side, strips, ratio), ratio**strips
    if low == high:
        return pieces
    # the strip at the wall is the first on the left and the last on the right side; corners are counted as in UNIT_SQUARE
    corner = (0, 1)[side] if low else (3, 2)[side]
    start = 0.0 if side == 0 else 1 - width
    at_corner = _cut_corner(corner, layers - strips, ratio) * [width, 1.0] + [start, 0.0]
    return np.concatenate([at_corner, pieces[1:] if side == 0 else pieces[:-1]])


def _cut_corner(corner: int, layers: int, ratio: float) -> Floats:
    """Cut the unit square into geometric layers towards a corner, counted as in ``UNIT_SQUARE``; shape (elements, 4, 2)."""
    # towards the corner (0, 0): a small square, and round it L-shaped layers of two quadrilaterals each
    quads = [ratio**layers * UNIT_SQUARE]
    for layer in range(layers):
        x, y = ratio**layer, ratio ** (layer + 1)
        quads += [np.array([[y, 0.0], [x, 0.0], [x, x], [y, y]]), np.array([[0.0, y], [y, y], [x, x], [0.0, x]])]
    turned = np.stack(quads)
    # mirrored to the corner; a mirrored quadrilateral's corners are listed backwards to stay counter-clockwise
    for axis, far in enumerate(UNIT_SQUARE[corner]):
        if far:
            turned[..., axis] = 1 - turned[..., axis]
            turned = turned[:, ::-1]
    return turned
