"""Draw the assembly from above, with a quarter cut away, by matplotlib."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from geometry.cad import solids

if TYPE_CHECKING:
    import cadquery
    from mpl_toolkits.mplot3d import Axes3D

    from geometry.common.arrays import Floats, Ints


VIEW_ELEVATION_DEG, VIEW_AZIMUTH_DEG = 22.0, -50.0  # degrees; direction of the viewer, who looks into the missing quarter


def draw_cutaway(axes: Axes3D, shapes: dict[str, cadquery.Solid], hole: float) -> None:
    """Draw the assembly without its quarter x > 0, y < 0, seen from that side; ``hole`` is the radius of the tube's hole."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    elevation, azimuth = math.radians(VIEW_ELEVATION_DEG), math.radians(VIEW_AZIMUTH_DEG)
    eye = np.array([math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)])
    low, high = _find_bounds(shapes["base"], shapes["inner"], shapes["outer"])
    for name, solid in shapes.items():
        triangles = _triangulate(_cut_quarter(solid, high), float(np.max(high - low)) / 30)
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        layers = np.where(normals @ eye > 0, _order_layers(name, triangles, normals, hole), -1)
        light = 0.6 + 0.4 * np.clip(normals @ np.array([0.15, -0.6, 0.79]), 0, 1)
        colours = light[:, None] * np.array(solids.PART_COLOURS[name])
        for layer in range(int(layers.max()) + 1):
            chosen = layers == layer
            faces = Poly3DCollection(triangles[chosen], facecolors=colours[chosen], antialiaseds=False, zorder=layer)
            axes.add_collection3d(faces)
    _set_view(axes, low, high)


def _order_layers(name: str, triangles: Floats, normals: Floats, hole: float) -> Ints:
    """Return the order in which the triangles are painted, since sorting by depth fails where a thin gap separates parts.

    Seen from outside and above, through the missing quarter, walls that face the axis are behind everything else. The inner
    parts and the boss follow, then the outer parts, the base, and last the cut faces, which nothing can hide.
    """
    centres = triangles.mean(axis=1)
    x, y, radius = centres[:, 0], centres[:, 1], np.hypot(centres[:, 0], centres[:, 1])
    outward = (x * normals[:, 0] + y * normals[:, 1]) / np.maximum(radius, 1e-300)
    layers = np.full(len(triangles), {"inner": 1, "film-inner": 1, "outer": 2, "film-outer": 2, "base": 3}[name])
    layers[(outward > 0.9) & (radius < hole)] = 1
    layers[(outward < -0.9) | ((outward < 0) & (normals[:, 2] < -1e-6))] = 0  # a hole's round edge faces down, too
    tolerance = 1e-9 * hole
    layers[((np.abs(y) < tolerance) & (x > 0)) | ((np.abs(x) < tolerance) & (y < 0))] = 4
    return layers


def _set_view(axes: Axes3D, low: Floats, high: Floats) -> None:
    """Set limits, scale and direction of the view so that the box between two corners fills the axes."""
    width, _, height = span = high - low
    elevation = math.radians(VIEW_ELEVATION_DEG)
    tall = height * math.cos(elevation) + width * math.sin(elevation)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(span, zoom=float(np.linalg.norm(span)) * min(0.92 / tall, 0.93 / width))
    axes.set_proj_type("ortho")
    axes.view_init(VIEW_ELEVATION_DEG, VIEW_AZIMUTH_DEG)
    axes.computed_zorder = False
    axes.set_axis_off()


def _find_bounds(*shapes: cadquery.Solid) -> tuple[Floats, Floats]:
    """Return the lower and the upper corner of the box around shapes, mm."""
    boxes = [shape.BoundingBox() for shape in shapes]
    low = np.min([(box.xmin, box.ymin, box.zmin) for box in boxes], axis=0)
    return low, np.max([(box.xmax, box.ymax, box.zmax) for box in boxes], axis=0)


def _cut_quarter(solid: cadquery.Solid, high: Floats) -> cadquery.Shape:
    """Return a solid without its quarter x > 0, y < 0; ``high`` is the upper corner of the box around the probe."""
    cq, (x, y, z) = solids.load_cadquery(), 2 * high
    return solids.call_modeller("drawing", lambda: solid.cut(cq.Solid.makeBox(x, y, 2 * z, cq.Vector(0, -y, -z / 2))))


def _triangulate(shape: cadquery.Shape, longest: float) -> Floats:
    """Return triangles (n, 3, 3) in mm, halved across their longest edge until none is longer than ``longest``."""
    vertices, faces = shape.tessellate(longest / 20, 0.15)
    triangles: Floats = np.array([vertex.toTuple() for vertex in vertices])[np.array(faces)]
    while True:
        lengths = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
        long = lengths.max(axis=1) > longest
        if not long.any():
            return triangles
        worst = lengths[long].argmax(axis=1)
        rows = np.arange(worst.size)
        a, b, c = (triangles[long][rows, (worst + shift) % 3] for shift in range(3))
        middle = (a + b) / 2
        triangles = np.concatenate([triangles[~long], np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
