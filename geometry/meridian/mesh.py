r"""Build block-structured quadrilateral meshes of the meridian half-plane: fixed topology, nodes smooth in the design.

Tissue (z <= 0) is cut into a strip under the surface, a box around the sphere and the rest. All lines in the box are rays
from the sphere's centre, so no cell can turn inside out; arcs are exact. Cells at a singular corner are cut into
geometric layers, which their neighbours do not see:

    z = 0    +-----------------------------+
             +---------+-------------------+      +-------+
             |\  top  /|                   |      |\      |   one layer of a
             | (sphere) side   right       |      | +---+ |   cell towards its
             |/ bottom\|                   |      | |   | |   lower left corner
             +---------+-------------------+      +-+---+-+
             |           bottom            |
    z = -H   +-----------------------------+
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from geometry.common.arrays import Floats, Ints, Numeric
from geometry.meridian.crossed_sphere import BoxLines, Cap, CrossedBox, place_box_lines
from geometry.meridian.mesh_lines import Kind, MeridianFineness, MeshLines, MeshTopology, place_lines
from geometry.meridian.section import LAYERS, Body, Section

TENSOR, OUTSIDE, INSIDE, CORE, ARCH, STRIP = range(6)
GOLDEN_RATIO = (5**0.5 - 1) / 2
LABEL_RADIUS_FACTOR = 20.0  # times: radii of the mesh that labels are taken from, whose sphere fits between its levels
LAYER_RATIO = 0.15  # ratio of sizes from one layer at a corner to the next
UNIT_SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
ELEMENT_SIDES = (
    (0, 1),
    (1, 2),
    (3, 2),
    (0, 3),
)  # corners of an element's sides, bottom, right, top and left, as its functions run
Vertex = tuple[int, int]  # number of the radius, number of the level
Place = tuple[Vertex, bool] | None  # a corner: lines of the grid, and whether that on the sphere's surface is meant
Cell = tuple[int, Body, tuple[Vertex, ...], tuple[int, int]]  # shape, body, vertices, circles


@dataclass(frozen=True, eq=False)
class Topology:
    """Elements by the lines of their cells; the same for all sections of a kind.

    Attributes
    ----------
    layout
        Numbers of the lines.
    shape
        TENSOR between lines, OUTSIDE or INSIDE the sphere between rays, in its CORE, or between columns on an ARCH of it or an
        interface (STRIP), see ``geometry.meridian.crossed_sphere``; shape (n,).
    vertices
        Radius and level of the cell's corners, counter-clockwise; in a ring, of its side of the box, twice; shape (n, 4, 2).
    circles
        The two circles of the cell in a ring, the two levels between which its columns stand, shape (n, 2).
    corners
        The element's in the cell's unit square, counter-clockwise, shape (n, 4, 2).
    body
        Of ``Body``, shape (n,).
    columns
        Rectangles come first, those between the same two radii one after the other: numbers of the first of each such run, and
        how many rectangles there are.
    """

    layout: MeshTopology
    shape: Ints
    vertices: Ints
    circles: Ints
    corners: Floats
    body: Ints
    columns: Ints


def build_topology(kind: Kind, fineness: MeridianFineness) -> Topology:
    """Return the elements of every mesh of a kind."""
    layout = MeshTopology(kind, fineness)
    singular, tips = dict(_list_singular_corners(layout)), layout.crossed.tips if layout.crossed is not None else {}
    cut = [_cut_layers(cell, layout, singular, tips) for cell in _list_cells(layout)]
    shape, body, vertices, circles = (np.array(column) for column in zip(*(cell for cell, _ in cut), strict=True))
    repeat = np.array([len(quads) for _, quads in cut])
    corners = np.concatenate([quads for _, quads in cut])
    shape, body, vertices, circles = (np.repeat(x, repeat, axis=0) for x in (shape, body, vertices, circles))
    order, columns = _order_columns((TENSOR,) if kind.layers[1] else (TENSOR, CORE), shape, vertices, corners)
    shape, body, vertices, circles, corners = (x[order] for x in (shape, body, vertices, circles, corners))
    return Topology(layout, shape, vertices=vertices, circles=circles, corners=corners, body=body, columns=columns)


def _order_columns(straight: tuple[int, ...], shape: Ints, vertices: Ints, corners: Floats) -> tuple[Ints, Ints]:
    """Return the order with rectangles (of ``straight`` shapes) first, column by column, and ``Topology.columns``."""
    sides = ((0, 3, 0), (1, 2, 0), (0, 1, 1), (3, 2, 1))  # two corners that share a radius or a level
    upright = np.all([x[:, a, axis] == x[:, b, axis] for x in (vertices, corners) for a, b, axis in sides], axis=0)
    flat = np.flatnonzero(upright & np.isin(shape, straight))
    column_keys = np.column_stack([shape[flat], *(x[flat, k, 0] for x in (vertices, corners) for k in (0, 1))])
    _, column, count = np.unique(column_keys, axis=0, return_inverse=True, return_counts=True)
    others = np.setdiff1d(np.arange(len(shape)), flat)
    return np.concatenate([flat[np.argsort(column.ravel(), kind="stable")], others]), np.concatenate([[0], np.cumsum(count)])


def compute_nodes(section: Section, mesh: Topology, places: Floats, chosen: Ints | None = None) -> Numeric:
    """Return points (r, z) of all or some elements at ``places`` of the unit square, (places, 2); (..., n, places, 2)."""
    if chosen is not None:
        shape, vertices, circles = mesh.shape[chosen], mesh.vertices[chosen], mesh.circles[chosen]
        corners, body = mesh.corners[chosen], mesh.body[chosen]
        mesh = replace(mesh, shape=shape, vertices=vertices, circles=circles, corners=corners, body=body)
    return _map_points(place_lines(section, mesh.layout), mesh, places)


def compute_labels(mesh: Topology) -> Floats:
    """Return dimensionless points (r, z), different for different corners, at the elements' corners, shape (n, 4, 2)."""
    layout, (radii, levels) = mesh.layout, 1 + mesh.vertices.reshape(-1, 2).max(axis=0)
    low, high = (label_line(layout.row.get(name, k)) for k, name in enumerate(("low", "high")))
    edge = label_line(layout.column.get("box", 1))
    outside, inside = (np.linspace(0.0, 1.0, rings + 1) for rings in layout.rings)
    lines = label_line(np.arange(radii)), label_line(np.arange(levels))
    if layout.crossed is not None:
        knots, heights, radius = layout.crossed.flatten(lines[1])
        drawn = np.interp(lines[1], [0.0, *knots, levels], [0.0, *heights, levels])
        box = place_box_lines(layout.crossed, LABEL_RADIUS_FACTOR * lines[0], drawn, (low + high) / 2, radius)
        flat = MeshLines(LABEL_RADIUS_FACTOR * lines[0], drawn, outside, inside, (low + high) / 2, radius, box)
        r, z = np.moveaxis(_map_points(flat, mesh, UNIT_SQUARE), -1, 0)
        points = np.stack([r / LABEL_RADIUS_FACTOR, np.interp(z, [0.0, *heights, levels], [0.0, *knots, levels])], axis=-1)
    else:
        radius, centre = 0.4 * min(edge, high - low), (low + high) / 2
        core = 0.4 * radius / np.hypot(edge, high - low)
        box = BoxLines(None, None, *np.broadcast_arrays(core * lines[0][:, None], core * (lines[1] - centre)))
        points = _map_points(MeshLines(*lines, outside, inside, centre, radius, box), mesh, UNIT_SQUARE)
    return np.asarray(np.round(points, 9)) + 0.0  # + 0.0: no negative zeros


def label_line(number: Numeric) -> Numeric:
    """Return a line's coordinate for ``compute_labels``: close to its number, but no line falls on a layer between others."""
    return np.round(number + 0.3 * np.modf(number * GOLDEN_RATIO)[0], 9)


def compute_bilinear_shares(places: Floats) -> Floats:
    """Return the bilinear weights of the unit square's corners at points of it, (..., 2) to (..., 4)."""
    u, v = places[..., 0], places[..., 1]
    return np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v], axis=-1)


def _map_points(lines: MeshLines, mesh: Topology, places: Floats) -> Numeric:
    """Map the elements' corners to the cells' unit squares and these to the plane."""
    points = compute_bilinear_shares(places) @ mesh.corners  # (n, places, 2)
    rings = (mesh.shape == OUTSIDE) | (mesh.shape == INSIDE)
    share = compute_bilinear_shares(np.where(rings[:, None, None], points * [1.0, 0.0], points))
    corners = (grid_lines[..., mesh.vertices[..., axis], None] for axis, grid_lines in enumerate((lines.radii, lines.levels)))
    r, z = ((share @ grid_lines)[..., 0] for grid_lines in corners)
    if lines.box is not None:
        r, z = _move_into_box(lines, mesh, share, points, (r, z))
    return np.stack([r, z], axis=-1)


def _interpolate_in_cells(grid: Numeric, mesh: Topology, share: Floats, chosen: Ints) -> Numeric:
    """Interpolate values at the box's points, (..., radii, levels), to points of chosen elements, shape (..., m, places)."""
    column, row = mesh.vertices[chosen].transpose(2, 0, 1)
    return (share[chosen] @ grid[..., column, row][..., None])[..., 0]


def _move_into_box(
    lines: MeshLines, mesh: Topology, share: Floats, unit_points: Floats, points: tuple[Numeric, Numeric]
) -> tuple[Numeric, Numeric]:
    """Move points of the box's sides along their rays into the rings, those of its grid into the core and onto the terrain."""
    box = lines.box
    assert box is not None
    centre, sphere = (np.asarray(x)[..., None, None] for x in (lines.centre, lines.sphere))
    kind = np.result_type(*points, centre, sphere, box.core_radii, box.core_heights, lines.outside, lines.inside)
    r, z = (coordinate.astype(kind) for coordinate in points)  # complex if any is
    out, ins, mid, arch, strip = (np.flatnonzero(mesh.shape == shape) for shape in (OUTSIDE, INSIDE, CORE, ARCH, STRIP))
    for ring, fractions in ((out, lines.outside), (ins, lines.inside)):
        start, end = (fractions[..., mesh.circles[ring, k], None] for k in (0, 1))
        t = start + (end - start) * unit_points[ring, :, 1]
        x, y = r[..., ring, :], z[..., ring, :] - centre
        if box.met is None:
            arc = sphere / (x**2 + y**2) ** 0.5
            a, b = arc * x, arc * y
        else:
            met = _interpolate_in_cells(box.met, mesh, share, ring)
            a, b = sphere * np.cos(met), sphere * np.sin(met)
        if ring is out:
            x = x if box.across is None else _interpolate_in_cells(box.across, mesh, share, ring)
            r[..., ring, :], z[..., ring, :] = t * x + (1 - t) * a, centre + t * y + (1 - t) * b
        else:
            x, y = (_interpolate_in_cells(coordinate, mesh, share, ring) for coordinate in (box.core_radii, box.core_heights))
            r[..., ring, :], z[..., ring, :] = (1 - t) * x + t * a, centre + (1 - t) * y + t * b
    r[..., mid, :] = _interpolate_in_cells(box.core_radii, mesh, share, mid)
    z[..., mid, :] = centre + _interpolate_in_cells(box.core_heights, mesh, share, mid)
    for chosen in (arch, strip):
        if len(chosen):
            (low, high), u = mesh.circles[chosen].T, unit_points[chosen, :, 0]
            foot, end = (lines.levels[..., rows, None] for rows in (low, high))
            t = (z[..., chosen, :] - foot) / (end - foot)
            a, b, met = (
                _interpolate_on_level(grid, mesh, chosen, rows, u)
                for grid, rows in ((box.across, low), (box.across, high), (box.met, low))
            )
            if chosen is arch:
                a, foot = sphere * np.cos(met), centre + sphere * np.sin(met)
            r[..., chosen, :], z[..., chosen, :] = (1 - t) * a + t * b, (1 - t) * foot + t * end
    return r, z


def _interpolate_on_level(grid: Numeric, mesh: Topology, chosen: Ints, rows: Ints, u: Floats) -> Numeric:
    """Interpolate values at the box's points along one level of each chosen element, at fractions u between its two columns."""
    left, right = (grid[..., mesh.vertices[chosen, k, 0], rows, None] for k in (0, 1))
    return left + u * (right - left)


def _list_cells(layout: MeshTopology) -> Iterator[Cell]:
    """Yield all cells, before those at corners are cut."""
    column = layout.column
    yield from _list_tissue_cells(layout)
    layers = (None, Body.FILM, Body.ADHESIVE)
    inner, outer = range(column["inner"] + 1), range(column["hole"], column["tube"] + 1)
    blocks = ((Body.INNER, inner, layout.inner), (Body.OUTER, outer, layout.outer))
    for (block, radii, levels), rows in zip(blocks, layout.blocks, strict=True):
        ends = [0, *(rows + k * layout.layer for k in range(layout.kind.films + 1))]
        for body, (first, last) in zip(layers, pairwise(ends), strict=False):
            yield from _list_grid_cells(body or block, radii, levels[first : last + 1])
    if layout.kind.base is not None:
        yield from _list_base_cells(layout)


def _list_grid_cells(body: Body, radii: Sequence[int], levels: Sequence[int]) -> Iterator[Cell]:
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
    if layout.crossed is not None:
        yield from _list_crossed_cells(layout, layout.crossed)
    elif "box" in layout.column:
        yield from _list_sphere_cells(layout, layout.box_lines)


def _list_merging_cells(body: Body, columns: tuple[int, ...], top: int, middle: int) -> Iterator[Cell]:
    """Yield the four cells by which three columns become one: left, right, between and below."""
    a, b, c, d = columns
    floor = top - 1
    left, right = ((a, floor), (b, middle), (b, top), (a, top)), ((c, middle), (d, floor), (d, top), (c, top))
    between, below = ((b, middle), (c, middle), (c, top), (b, top)), ((a, floor), (d, floor), (c, middle), (b, middle))
    for vertices in (left, right, between, below):
        yield TENSOR, body, vertices, (0, 0)


def _find_layer(layout: MeshTopology, top: int) -> Body:
    """Return the body of the tissue's row below a level: a layer, or the tissue below all layers."""
    layer = sum(interface >= top for interface in layout.interfaces)
    return LAYERS[layer] if layer < len(layout.interfaces) else Body.TISSUE


def _list_sphere_cells(layout: MeshTopology, radii: Sequence[int]) -> Iterator[Cell]:
    """Yield the cells of the box: rings on its three sides (each counted so that cells are right-handed) and the core."""
    edge, low, high = radii[-1], layout.row["low"], layout.row["high"]
    sides = [(_find_layer(layout, high), ((a, high), (b, high)) * 2) for a, b in pairwise(radii)]
    sides += [(_find_layer(layout, d), ((edge, d), (edge, c)) * 2) for c, d in pairwise(range(low, high + 1))]
    sides += [(_find_layer(layout, low + 1), ((b, low), (a, low)) * 2) for a, b in pairwise(radii)]
    for shape, count in zip((OUTSIDE, INSIDE), layout.rings, strict=True):
        for (body, side), circle in product(sides, range(count)):
            yield shape, body if shape == OUTSIDE else Body.INCLUSION, side, (circle, circle + 1)
    for _, body, vertices, circles in _list_grid_cells(Body.INCLUSION, radii, range(low, high + 1)):
        yield CORE, body, vertices, circles


def _list_crossed_cells(layout: MeshTopology, box: CrossedBox) -> Iterator[Cell]:
    """Yield the cells of a box that interfaces cross: likewise, and those between columns."""
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
    """Yield the cells between a cap's columns: strips from the box's end to the first interface, from there to the next."""
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


def find_interface_ends(mesh: Topology) -> Ints:
    """Return the elements of the cells at interfaces' ends at the tissue's side, shape (m,)."""
    interfaces = mesh.layout.interfaces
    if not interfaces:
        return np.empty(0, dtype=np.intp)
    is_end = (mesh.vertices[..., 0] == mesh.layout.column["side"]) & np.isin(mesh.vertices[..., 1], interfaces)
    return np.flatnonzero(np.any(is_end, axis=1))


def _list_singular_corners(layout: MeshTopology) -> Iterator[tuple[Place, int]]:
    """Yield the corners with singular stresses and how many layers cells have there.

    The blocks' corners, where interfaces meet the sphere, and where the side meets floor and interfaces.
    """
    layers = layout.fineness.layers
    column, surface = layout.column, layout.row["surface"]
    tops = layout.inner[layout.blocks[0]], layout.outer[layout.blocks[1]]
    for radius, top in zip(("inner", "hole", "tube"), (tops[0], tops[1], tops[1]), strict=True):
        yield ((column.get(f"{radius} edge", column[radius]), surface), False), layers
        yield ((column[radius], top), False), layers
    yield ((column["side"], layout.row["floor"]), False), layers
    for level, cut in zip(layout.interfaces, layout.kind.ends, strict=True):
        if cut:
            yield ((column["side"], level), False), layers
    if layout.kind.flange:
        yield ((column["tube"], layout.base[layout.step]), False), layers
    if layout.kind.base:
        yield ((layout.bridge[len(layout.bridge) // 2], layout.boss[-1]), False), layers
    if layout.crossed is None:
        return
    for level in layout.crossed.sides:
        yield ((column["box"], level), True), layers
    for cap in layout.crossed.caps:
        for start, level in zip(cap.starts, cap.rows, strict=True):
            line = layout.crossed.lines[start]
            max_layers = min(layers, layout.crossed.tips[line, level])
            yield ((line, cap.last), True), max_layers
            yield ((line, level), False), max_layers


def _list_corners(cell: Cell, rings: int) -> Iterator[Place]:
    """Name a cell's corners: lines of the grid, or rays that meet the sphere."""
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


def _cut_layers(cell: Cell, layout: MeshTopology, singular: dict[Place, int], tips: dict[Vertex, int]) -> tuple[Cell, Floats]:
    """Cut a cell's unit square into geometric layers towards its singular corner or point, if any; shape (elements, 4, 2)."""
    point = _find_point_side(cell, tips)
    if point is not None:
        _, _, vertices, circles = cell
        tip = vertices[point] if vertices[point] in tips else (vertices[0][0], circles[1])
        ends = np.array([0.0, *(LAYER_RATIO**k for k in range(min(layout.fineness.layers, tips[tip]), -1, -1))])
        pieces = [UNIT_SQUARE * [high - low, 1.0] + [low, 0.0] for low, high in pairwise(np.sort(np.abs(point - ends)))]
        return cell, np.stack(pieces)
    corners = [(k, singular[place]) for k, place in enumerate(_list_corners(cell, layout.rings[1])) if place in singular]
    if not corners or not corners[0][1]:
        return cell, UNIT_SQUARE[None]
    ((k, layers),) = corners  # two cells at least lie between any two singular corners
    quads = [LAYER_RATIO**layers * UNIT_SQUARE]
    for layer in range(layers):
        x, y = LAYER_RATIO**layer, LAYER_RATIO ** (layer + 1)
        quads += [np.array([[y, 0.0], [x, 0.0], [x, x], [y, y]]), np.array([[0.0, y], [y, y], [x, x], [0.0, x]])]
    turned = np.stack(quads)
    for axis, far in enumerate(UNIT_SQUARE[k]):
        if far:
            turned[..., axis] = 1 - turned[..., axis]
            turned = turned[:, ::-1]
    return cell, turned
