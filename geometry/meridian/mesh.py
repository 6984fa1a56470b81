r"""Block-structured quadrilateral meshes of the meridian half-plane: fixed topology, nodes smooth in the design.

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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Any

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from geometry.meridian.frame import Kind, MeridianFineness, MeshLines, MeshTopology, frame
from geometry.meridian.section import LAYERS, Body, Section

TENSOR, OUTSIDE, INSIDE, CORE = range(4)
GOLDEN = (5**0.5 - 1) / 2
LAYER = 0.15  # ratio of sizes from one layer at a corner to the next
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
SIDES = ((0, 1), (1, 2), (3, 2), (0, 3))  # corners of an element's sides, bottom, right, top and left, as its functions run
Vertex = tuple[int, int]  # number of the radius, number of the level
Cell = tuple[int, Body, tuple[Vertex, ...], tuple[int, int]]  # shape, body, vertices, circles


@dataclass(frozen=True, eq=False)
class Topology:
    """Elements by the lines of their cells; the same for all sections of a kind.

    Attributes:
        layout: numbers of the lines.
        shape: TENSOR between lines, OUTSIDE or INSIDE the sphere between rays, or in its CORE; shape (n,).
        vertices: radius and level of the cell's corners, counter-clockwise; in a ring, of its side of the box, twice;
            shape (n, 4, 2).
        circles: the two circles of the cell in a ring, shape (n, 2).
        corners: the element's in the cell's unit square, counter-clockwise, shape (n, 4, 2).
        body: of ``Body``, shape (n,).
        columns: rectangles come first, those between the same two radii one after the other: numbers of the first of each such
            run, and how many rectangles there are.
    """

    layout: MeshTopology
    shape: Ints
    vertices: Ints
    circles: Ints
    corners: Floats
    body: Ints
    columns: Ints


def topology(kind: Kind, fineness: MeridianFineness) -> Topology:
    """Return the elements of every mesh of a kind."""
    layout = MeshTopology(kind, fineness)
    singular = set(_singular(layout))
    cut = [_layers(cell, singular, fineness.layers) for cell in _cells(layout)]
    shape, body, vertices, circles = (np.array(column) for column in zip(*(cell for cell, _ in cut), strict=True))
    repeat = np.array([len(quads) for _, quads in cut])
    corners = np.concatenate([quads for _, quads in cut])
    shape, body, vertices, circles = (np.repeat(x, repeat, axis=0) for x in (shape, body, vertices, circles))
    order, columns = _columns((TENSOR,) if kind.layers[1] else (TENSOR, CORE), shape, vertices, corners)
    shape, body, vertices, circles, corners = (x[order] for x in (shape, body, vertices, circles, corners))
    return Topology(layout, shape, vertices=vertices, circles=circles, corners=corners, body=body, columns=columns)


def _columns(straight: tuple[int, ...], shape: Ints, vertices: Ints, corners: Floats) -> tuple[Ints, Ints]:
    """The order in which rectangles come first, column by column, and ``Topology.columns``; of ``straight`` shapes some are."""
    sides = ((0, 3, 0), (1, 2, 0), (0, 1, 1), (3, 2, 1))  # two corners that share a radius or a level
    upright = np.all([x[:, a, axis] == x[:, b, axis] for x in (vertices, corners) for a, b, axis in sides], axis=0)
    flat = np.flatnonzero(upright & np.isin(shape, straight))
    between = np.column_stack([shape[flat], *(x[flat, k, 0] for x in (vertices, corners) for k in (0, 1))])
    _, column, count = np.unique(between, axis=0, return_inverse=True, return_counts=True)
    others = np.setdiff1d(np.arange(len(shape)), flat)
    return np.concatenate([flat[np.argsort(column.ravel(), kind="stable")], others]), np.concatenate([[0], np.cumsum(count)])


def nodes(section: Section, mesh: Topology, places: Floats, chosen: Ints | None = None) -> Any:
    """Return points (r, z) of all or some elements at ``places`` of the unit square, (places, 2); (..., n, places, 2)."""
    if chosen is not None:
        shape, vertices, circles = mesh.shape[chosen], mesh.vertices[chosen], mesh.circles[chosen]
        corners, body = mesh.corners[chosen], mesh.body[chosen]
        mesh = replace(mesh, shape=shape, vertices=vertices, circles=circles, corners=corners, body=body)
    return _mapped(frame(section, mesh.layout), mesh, places)


def labels(mesh: Topology) -> Floats:
    """Return points (r, z) that tell the elements' corners apart, from a mesh without dimensions, shape (n, 4, 2)."""
    layout, (radii, levels) = mesh.layout, 1 + mesh.vertices.reshape(-1, 2).max(axis=0)
    low, high = (line_label(layout.row.get(name, k)) for k, name in enumerate(("low", "high")))
    edge = line_label(layout.column.get("box", 1))
    outside, inside = (np.linspace(0.0, 1.0, rings + 1) for rings in layout.rings)
    radius = 0.4 * min(edge, high - low)
    core = 0.4 * radius / np.hypot(edge, high - low)
    lines = line_label(np.arange(radii)), line_label(np.arange(levels))
    flat = MeshLines(*lines, outside, inside, (low + high) / 2, radius, core)
    return np.asarray(np.round(_mapped(flat, mesh, SQUARE), 9)) + 0.0  # + 0.0: no negative zeros


def line_label(number: Any) -> Any:
    """The coordinate by which ``labels`` knows a line: close to its number, but no line falls on a layer between two others."""
    return np.round(number + 0.3 * np.modf(number * GOLDEN)[0], 9)


def bilinear(places: Floats) -> Floats:
    """Shares of the unit square's corners at points of it, (..., 2) to (..., 4)."""
    u, v = places[..., 0], places[..., 1]
    return np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v], axis=-1)


def _mapped(lines: MeshLines, mesh: Topology, places: Floats) -> Any:
    """Map the elements' corners to the cells' unit squares and these to the plane."""
    within = bilinear(places) @ mesh.corners  # (n, places, 2)
    rings = (mesh.shape == OUTSIDE) | (mesh.shape == INSIDE)
    share = bilinear(np.where(rings[:, None, None], within * [1.0, 0.0], within))
    corners = (along[..., mesh.vertices[..., axis], None] for axis, along in enumerate((lines.radii, lines.levels)))
    r, z = ((share @ along)[..., 0] for along in corners)
    if np.any(rings):
        r, z = _around(lines, mesh, share, within[..., 1], (r, z))
    return np.stack([r, z], axis=-1)


def _turned(turns: Any, mesh: Topology, share: Floats, boxed: Bools) -> Any:
    """The turn of each point's ray, shape (..., n, places), 0 outside the box."""
    out = np.zeros((*turns.shape[:-2], *share.shape[:2]), dtype=turns.dtype)
    column, row = mesh.vertices[boxed].transpose(2, 0, 1)
    out[..., boxed, :] = (share[boxed] @ turns[..., column, row][..., None])[..., 0]
    return out


def _around(lines: MeshLines, mesh: Topology, share: Floats, v: Floats, points: tuple[Any, Any]) -> tuple[Any, Any]:
    """Move points of the box's sides along their rays into the rings, and those of the box's grid into the core."""
    turn = None if lines.turn is None else _turned(lines.turn, mesh, share, mesh.shape != TENSOR)
    centre, sphere, core = (np.asarray(x)[..., None, None] for x in (lines.centre, lines.sphere, lines.core))
    kind = np.result_type(*points, centre, sphere, core, lines.outside, lines.inside, 0.0 if turn is None else turn)
    r, z = (one.astype(kind) for one in points)  # complex if any is
    out, ins, mid = (np.flatnonzero(mesh.shape == shape) for shape in (OUTSIDE, INSIDE, CORE))
    for ring, fractions in ((out, lines.outside), (ins, lines.inside)):
        x, y = r[..., ring, :], z[..., ring, :] - centre
        start, end = (fractions[..., mesh.circles[ring, k], None] for k in (0, 1))
        t, arc = start + (end - start) * v[ring], sphere / (x**2 + y**2) ** 0.5
        on_box, turned = (t, arc * (1 - t)) if ring is out else (0 * t, core * (1 - t) + arc * t)
        a, b = _rotated(x, y, turn, ring)
        r[..., ring, :], z[..., ring, :] = on_box * x + turned * a, centre + on_box * y + turned * b
    a, b = _rotated(r[..., mid, :], z[..., mid, :] - centre, turn, mid)
    r[..., mid, :], z[..., mid, :] = core * a, centre + core * b
    return r, z


def _rotated(x: Any, y: Any, turn: Any, chosen: Ints) -> tuple[Any, Any]:
    """Turn points of the chosen elements about the sphere's centre."""
    if turn is None:
        return x, y
    cos, sin = np.cos(turn[..., chosen, :]), np.sin(turn[..., chosen, :])
    return cos * x - sin * y, sin * x + cos * y


def _cells(layout: MeshTopology) -> Iterator[Cell]:
    """Yield all cells, before those at corners are cut."""
    column = layout.column
    yield from _tissue(layout)
    layers = (None, Body.FILM, Body.ADHESIVE)
    inner, outer = range(column["inner"] + 1), range(column["hole"], column["tube"] + 1)
    blocks = ((Body.INNER, inner, layout.inner), (Body.OUTER, outer, layout.outer))
    for (block, across, levels), rows in zip(blocks, layout.blocks, strict=True):
        ends = [0, *(rows + k * layout.layer for k in range(layout.kind.films + 1))]
        for body, (first, last) in zip(layers, pairwise(ends), strict=False):
            yield from _grid(body or block, across, levels[first : last + 1])
    if layout.kind.base is not None:
        yield from _base(layout)


def _grid(body: Body, radii: Sequence[int], levels: Sequence[int]) -> Iterator[Cell]:
    for (a, b), (c, d) in product(pairwise(radii), pairwise(levels)):
        yield TENSOR, body, ((a, c), (b, c), (b, d), (a, d)), (0, 0)


def _tissue(layout: MeshTopology) -> Iterator[Cell]:
    """Yield the tissue's cells row by row from the surface, then the sphere with what is around it."""
    radii, low, high = list(range(layout.column["side"] + 1)), layout.row.get("low", 0), layout.row.get("high", 0)
    for top in range(layout.row["surface"], 0, -1):
        ended = {line for group in layout.merged.get(top, []) for line in group[1:-1]}
        for group in layout.merged.get(top, []):
            yield from _merging(_layer(layout, top), group, top, layout.middles[top])
        first = layout.column["box"] if low < top <= high else 0
        for a, b in pairwise(radii):
            if a >= first and not {a, b} & ended:
                yield from _grid(_layer(layout, top), (a, b), (top - 1, top))
        radii = [line for line in radii if line not in ended]
    if "box" in layout.column:
        yield from _sphere(layout, [line for line in radii if line <= layout.column["box"]])


def _merging(body: Body, columns: tuple[int, ...], top: int, middle: int) -> Iterator[Cell]:
    """Yield the four cells by which three columns become one: left, right, between and below."""
    a, b, c, d = columns
    floor = top - 1
    left, right = ((a, floor), (b, middle), (b, top), (a, top)), ((c, middle), (d, floor), (d, top), (c, top))
    between, below = ((b, middle), (c, middle), (c, top), (b, top)), ((a, floor), (d, floor), (c, middle), (b, middle))
    for vertices in (left, right, between, below):
        yield TENSOR, body, vertices, (0, 0)


def _layer(layout: MeshTopology, top: int) -> Body:
    """The body of the tissue's row below a level: a layer, or what is below the last."""
    layer = sum(interface >= top for interface in layout.interfaces)
    return LAYERS[layer] if layer < len(layout.interfaces) else Body.TISSUE


def _sphere(layout: MeshTopology, radii: Sequence[int]) -> Iterator[Cell]:
    """Yield the cells of the box: rings on its three sides (each counted so that cells are right-handed) and the core."""
    edge, low, high = radii[-1], layout.row["low"], layout.row["high"]
    sides = [(_layer(layout, high), ((a, high), (b, high)) * 2) for a, b in pairwise(radii)]
    sides += [(_layer(layout, d), ((edge, d), (edge, c)) * 2) for c, d in pairwise(range(low, high + 1))]
    sides += [(_layer(layout, low + 1), ((b, low), (a, low)) * 2) for a, b in pairwise(radii)]
    for shape, count in zip((OUTSIDE, INSIDE), layout.rings, strict=True):
        for (body, side), circle in product(sides, range(count)):
            yield shape, body if shape == OUTSIDE else Body.INCLUSION, side, (circle, circle + 1)
    for _, body, vertices, circles in _grid(Body.INCLUSION, radii, range(low, high + 1)):
        yield CORE, body, vertices, circles


def _base(layout: MeshTopology) -> Iterator[Cell]:
    """Yield the cells of an elastic base: boss, step and flange."""
    column, kind, middle = layout.column, layout.kind, len(layout.bridge) // 2
    inner = (*range(column["inner"]), *layout.bridge[: middle + 1])
    outer = (*layout.bridge[middle:], *range(column["hole"] + 1, column["tube"] + 1))
    if kind.base:
        yield from _grid(Body.BASE, inner if kind.base < 0 else outer, layout.boss)
    yield from _grid(Body.BASE, (*inner, *outer[1:]), layout.base)
    if kind.flange:
        yield from _grid(Body.BASE, layout.flange, layout.base[layout.step :])


def interface_ends(mesh: Topology) -> Ints:
    """Return the elements of the cells at interfaces' ends at the tissue's side, shape (m,)."""
    interfaces = mesh.layout.interfaces
    if not interfaces:
        return np.empty(0, dtype=np.intp)
    at = (mesh.vertices[..., 0] == mesh.layout.column["side"]) & np.isin(mesh.vertices[..., 1], interfaces)
    return np.flatnonzero(np.any(at, axis=1))


def _singular(layout: MeshTopology) -> Iterator[tuple[int, int]]:
    """Yield the corners (radius, level) with singular stresses: the blocks', and where the side meets floor and interfaces."""
    column, surface = layout.column, layout.row["surface"]
    tops = layout.inner[layout.blocks[0]], layout.outer[layout.blocks[1]]
    for radius, top in zip(("inner", "hole", "tube"), (tops[0], tops[1], tops[1]), strict=True):
        yield column.get(f"{radius} edge", column[radius]), surface
        yield column[radius], top
    yield column["side"], layout.row["floor"]
    for level, cut in zip(layout.interfaces, layout.kind.ends, strict=True):
        if cut:
            yield column["side"], level
    if layout.kind.flange:
        yield column["tube"], layout.base[layout.step]
    if layout.kind.base:
        yield layout.bridge[len(layout.bridge) // 2], layout.boss[-1]


def _layers(cell: Cell, singular: set[tuple[int, int]], layers: int) -> tuple[Cell, Floats]:
    """Cut a cell's unit square into geometric layers towards its singular corner, if it has one; shape (elements, 4, 2)."""
    shape, _, vertices, _ = cell
    corners = [k for k, vertex in enumerate(vertices) if vertex in singular]
    if shape != TENSOR or not corners or layers == 0:
        return cell, SQUARE[None]
    (k,) = corners  # two cells at least lie between any two singular corners
    quads = [LAYER**layers * SQUARE]
    for layer in range(layers):
        x, y = LAYER**layer, LAYER ** (layer + 1)
        quads += [np.array([[y, 0.0], [x, 0.0], [x, x], [y, y]]), np.array([[0.0, y], [y, y], [x, x], [0.0, x]])]
    turned = np.stack(quads)
    for axis, far in enumerate(SQUARE[k]):
        if far:
            turned[..., axis] = 1 - turned[..., axis]
            turned = turned[:, ::-1]
    return cell, turned
