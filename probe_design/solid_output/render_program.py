"""Render coloured triangles and lines in three dimensions, as a program of ``geometry/processes/child.py``."""

from __future__ import annotations

import numpy as np
import pyvista

from geometry.common.arrays import Floats
from geometry.common.json_types import JsonObject

VIEW_DIRECTION = (-0.42, -1.0, 0.5)  # towards the camera
LIGHT_POSITION = (-0.45, -1.0, 0.95)  # so that cut and top are both bright, but differently
PLANE_TOLERANCE_RELATIVE = 1e-7  # of the mesh's size: points this close to y = 0 count as in the plane
LINE_OFFSET_RELATIVE = 1e-3  # of the mesh's size: lines are moved this far in front of their surfaces


def run(drawing: JsonObject) -> Floats:
    """Draw the part y >= 0 on white, viewed from the side of the cut and slightly from above; see ``render.render_faces``.

    Returns
    -------
    Floats
        Pixels from 0 to 1, shape (height, width, 3).
    """
    points, triangles, colours, lines, half_height = (
        drawing[name] for name in ("points", "triangles", "colours", "lines", "half_height")
    )
    surface = pyvista.PolyData.from_regular_faces(points, triangles)
    edges = pyvista.PolyData(points, lines=np.column_stack([np.full(len(lines), 2), lines]).ravel())  # 2: points of each line
    surface.cell_data["colour"] = colours
    min_y = -PLANE_TOLERANCE_RELATIVE * float(np.ptp(points, axis=0).max())
    if points[:, 1].min() < min_y:
        surface, edges = (part.clip(normal="y", origin=(0, min_y, 0), invert=False) for part in (surface, edges))
    # moved towards the camera, so that surfaces do not hide them
    edges.points = edges.points + LINE_OFFSET_RELATIVE * np.ptp(points, axis=0).max() * np.array(VIEW_DIRECTION)
    plotter = pyvista.Plotter(off_screen=True, window_size=[*drawing["size"]], lighting="none")
    plotter.add_light(pyvista.Light(position=LIGHT_POSITION, focal_point=(0, 0, 0), light_type="scene light"))
    plotter.renderer.set_background("white")
    plotter.add_mesh(surface, scalars="colour", rgb=True, ambient=0.45, diffuse=0.75, specular=0.0)
    plotter.add_mesh(edges, color="black", line_width=3.0 if half_height else 1.6, opacity=0.6)
    plotter.renderer.enable_parallel_projection()
    plotter.enable_anti_aliasing("ssaa")
    plotter.camera_position = [tuple(np.add(surface.center, VIEW_DIRECTION)), surface.center, (0, 0, 1)]
    plotter.renderer.reset_camera()
    plotter.camera.Zoom(1.25)
    if half_height > 0:
        plotter.camera.focal_point, plotter.camera.parallel_scale = (0, 0, -0.3 * half_height), half_height
        plotter.camera.position = tuple(2 * np.ptp(points, axis=0).max() * np.array(VIEW_DIRECTION))
        plotter.reset_camera_clipping_range()
    pixels: Floats = np.asarray(plotter.screenshot(return_img=True))[:, :, :3] / np.float32(255)
    plotter.close()
    return pixels
