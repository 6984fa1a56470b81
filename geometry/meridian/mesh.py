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

from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats, Ints, Numeric
from geometry.meridian.crossed_sphere import BoxLines, place_box_lines
from geometry.meridian.mesh_cells import (
    ARCH,
    CORE,
    INSIDE,
    OUTSIDE,
    STRIP,
    TENSOR,
    UNIT_SQUARE,
    cut_layers,
    list_cells,
    list_singular_corners,
)
from geometry.meridian.mesh_lines import Kind, MeridianFineness, MeshLines, MeshTopology, place_lines
from geometry.meridian.section import Section

GOLDEN_RATIO = (5**0.5 - 1) / 2
LABEL_RADIUS_FACTOR = 20.0  # times: radii of the mesh that labels are taken from, whose sphere fits between its levels
ELEMENT_SIDES = (
    (0, 1),
    (1, 2),
    (3, 2),
    (0, 3),
)  # corners of an element's sides, bottom, right, top and left, as its functions run


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
    """Return the elements that all meshes of a kind have in common: their cells by numbers of lines, no coordinates."""
    layout = MeshTopology(kind, fineness)
    singular, tips = dict(list_singular_corners(layout)), layout.box.tips if layout.box is not None else {}
    cut = [cut_layers(cell, layout, singular, tips) for cell in list_cells(layout)]
    shape, body, vertices, circles = (np.array(column) for column in zip(*(cell for cell, _ in cut), strict=True))
    repeat = np.array([len(quads) for _, quads in cut])
    corners = np.concatenate([quads for _, quads in cut])
    shape, body, vertices, circles = (np.repeat(x, repeat, axis=0) for x in (shape, body, vertices, circles))
    order, columns = _order_columns((TENSOR,) if kind.layers[1] else (TENSOR, CORE), shape, vertices, corners)
    shape, body, vertices, circles, corners = (x[order] for x in (shape, body, vertices, circles, corners))
    return Topology(layout, shape, vertices=vertices, circles=circles, corners=corners, body=body, columns=columns)


def _order_columns(straight: tuple[int, ...], shape: Ints, vertices: Ints, corners: Floats) -> tuple[Ints, Ints]:
    """Return an order of the elements, rectangles first and column by column, and ``Topology.columns``.

    Only cells of the ``straight`` shapes are upright rectangles where their corners are.
    """
    sides = ((0, 3, 0), (1, 2, 0), (0, 1, 1), (3, 2, 1))  # two corners that share a radius or a level
    upright = np.all([x[:, a, axis] == x[:, b, axis] for x in (vertices, corners) for a, b, axis in sides], axis=0)
    flat = np.flatnonzero(upright & np.isin(shape, straight))
    column_keys = np.column_stack([shape[flat], *(x[flat, k, 0] for x in (vertices, corners) for k in (0, 1))])
    _, column, count = np.unique(column_keys, axis=0, return_inverse=True, return_counts=True)
    others = np.setdiff1d(np.arange(len(shape)), flat)
    return np.concatenate([flat[np.argsort(column.ravel(), kind="stable")], others]), np.concatenate([[0], np.cumsum(count)])


def compute_nodes(section: Section, mesh: Topology, places: Floats, chosen: Ints | None = None) -> Numeric:
    """Return points (r, z) of a section's mesh in m, shape (..., n, places, 2).

    They are the points ``places`` (places, 2) of the unit square, mapped to all n elements, or to the rows ``chosen`` of them.
    """
    if chosen is not None:
        shape, vertices, circles = mesh.shape[chosen], mesh.vertices[chosen], mesh.circles[chosen]
        corners, body = mesh.corners[chosen], mesh.body[chosen]
        mesh = replace(mesh, shape=shape, vertices=vertices, circles=circles, corners=corners, body=body)
    return _map_points(place_lines(section, mesh.layout), mesh, places)


def compute_labels(mesh: Topology) -> Floats:
    """Return dimensionless points (r, z) at the elements' corners, shape (n, 4, 2), by which equal corners are recognised.

    They are the corners of a drawing of the mesh that depends on its kind alone: one corner has the same label in all elements.
    """
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
    """Return a line's coordinate for ``compute_labels``: its number, shifted by an irregular fraction of up to 0.3.

    Without the shift a line could coincide with a geometric layer between two other lines.
    """
    return np.round(number + 0.3 * np.modf(number * GOLDEN_RATIO)[0], 9)


def compute_bilinear_shares(places: Floats) -> Floats:
    """Return the bilinear weights of the unit square's corners at points of it, (..., 2) to (..., 4)."""
    u, v = places[..., 0], places[..., 1]
    return np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v], axis=-1)


def _map_points(lines: MeshLines, mesh: Topology, places: Floats) -> Numeric:
    """Return points (r, z), shape (..., n, places, 2): the elements' unit squares, mapped to cells and these to the plane."""
    points = compute_bilinear_shares(places) @ mesh.corners  # (n, places, 2)
    rings = (mesh.shape == OUTSIDE) | (mesh.shape == INSIDE)
    # in a ring only the position along the box's side is interpolated here; that across it follows in ``_move_into_box``
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
    """Return points (r, z) of the box moved to their places, each (..., n, places).

    Points of the box's sides move along their rays into the rings, those of its grid into the core or between the columns on the
    cap and on interfaces. ``share`` are the bilinear weights of a cell's corners, ``unit_points`` the points in the cells' unit
    squares, ``points`` r and z before.
    """
    box = lines.box
    assert box is not None
    centre, sphere = (np.asarray(x)[..., None, None] for x in (lines.centre, lines.sphere))
    kind = np.result_type(*points, centre, sphere, box.core_radii, box.core_heights, lines.outside, lines.inside)
    r, z = (coordinate.astype(kind) for coordinate in points)  # complex if any is
    out, ins, mid, arch, strip = (np.flatnonzero(mesh.shape == shape) for shape in (OUTSIDE, INSIDE, CORE, ARCH, STRIP))
    for ring, fractions in ((out, lines.outside), (ins, lines.inside)):
        start, end = (fractions[..., mesh.circles[ring, k], None] for k in (0, 1))
        t = start + (end - start) * unit_points[ring, :, 1]  # from 0 at the ray's inner end to 1 at its outer
        x, y = r[..., ring, :], z[..., ring, :] - centre
        if box.met is None:
            arc = sphere / (x**2 + y**2) ** 0.5
            a, b = arc * x, arc * y  # where the ray meets the sphere, relative to its centre
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
    """Interpolate values at the box's points along the levels ``rows``, one for each chosen element.

    ``u`` (m, places) are fractions of the way between the element's two columns.
    """
    left, right = (grid[..., mesh.vertices[chosen, k, 0], rows, None] for k in (0, 1))
    return left + u * (right - left)


def find_interface_ends(mesh: Topology) -> Ints:
    """Return the rows of the elements of all cells that touch an interface's end at the tissue's side, shape (m,)."""
    interfaces = mesh.layout.interfaces
    if not interfaces:
        return np.empty(0, dtype=np.intp)
    is_end = (mesh.vertices[..., 0] == mesh.layout.column["side"]) & np.isin(mesh.vertices[..., 1], interfaces)
    return np.flatnonzero(np.any(is_end, axis=1))
