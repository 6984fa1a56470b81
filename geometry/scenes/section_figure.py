"""Draw the section of a scene through the probe's axis, to scale."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch, Rectangle

from geometry.scenes.scene_tables import BlockTissue, CylinderTissue, Inclusion, SceneTables
from geometry.scenes.units import MM_PER_M, format_modulus

INNER_COLOUR, OUTER_COLOUR, BASE_COLOUR, TUMOUR_COLOUR = "#2a6f97", "#61a5c2", "#495057", "#9d0208"
TISSUE_COLOURS = ("#f6d5c3", "#eebfa5", "#fae3d7", "#e5a98a")  # of the tissue below its layers, then of the layers in turn
PROBE_RADII, TUMOUR_DEPTHS = 3.0, 1.5  # relative: shown to each side of the probe; shown of the depth of the deepest tumour
BASE_HEIGHT_RADII = 0.15  # relative: of the base that is drawn


def draw_section(scene: SceneTables) -> Figure:
    """Draw the section in the plane of the probe's axis and the x-axis, in mm; tumours beside the plane are drawn in outline.

    A tilt is not drawn. Ellipsoids and bodies from files are drawn as circles of their mean or stated diameter.
    """
    figure = Figure(figsize=(7.0, 5.0), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    probe, tissue, centre = scene.probe, scene.tissue, scene.placement.x
    deepest = max([TUMOUR_DEPTHS * body.depth for body in scene.inclusion] + [2 * probe.tube_radius])
    depth = tissue.depth if isinstance(tissue, CylinderTissue | BlockTissue) else np.inf
    shown_depth = min(depth, deepest)
    reach = max([PROBE_RADII * probe.tube_radius] + [abs(body.x - centre) + _find_radius(body) for body in scene.inclusion])
    left, right = centre - reach, centre + reach
    half = np.inf
    if isinstance(tissue, CylinderTissue | BlockTissue):
        half = tissue.radius if isinstance(tissue, CylinderTissue) else tissue.length / 2
    low, high = max(left, -half), min(right, half)
    levels = (0.0, *(level for level in tissue.interfaces if level < shown_depth), shown_depth)
    for k, (top, bottom) in enumerate(pairwise(levels)):
        material = tissue.find_material((top + bottom) / 2)
        colour = TISSUE_COLOURS[0] if k == len(levels) - 2 else TISSUE_COLOURS[1 + k % 3]
        name = "tissue" if k == len(levels) - 2 else "layer"
        _draw_box(axes, (low, high), (-bottom, -top), colour, f"{name}, {format_modulus(material.youngs_modulus)}")
    for sides, height, colour, label in (
        ((-probe.inner_radius, probe.inner_radius), probe.core_height, INNER_COLOUR, "inner block"),
        ((probe.hole_radius, probe.tube_radius), probe.tube_height, OUTER_COLOUR, "outer block"),
        ((-probe.tube_radius, -probe.hole_radius), probe.tube_height, OUTER_COLOUR, ""),
    ):
        material = probe.inner if colour == INNER_COLOUR else probe.outer
        text = f"{label}, {format_modulus(material.youngs_modulus)}" if label else ""
        _draw_box(axes, (centre + sides[0], centre + sides[1]), (0.0, height), colour, text)
    top = max(probe.core_height, probe.tube_height)
    for sides, height in (((-probe.hole_radius, probe.hole_radius), probe.core_height),
                          ((probe.hole_radius, probe.tube_radius), probe.tube_height),
                          ((-probe.tube_radius, -probe.hole_radius), probe.tube_height)):  # fmt: skip
        ceiling = top + BASE_HEIGHT_RADII * probe.tube_radius
        label = "base" if sides[0] == -probe.hole_radius else ""
        _draw_box(axes, (centre + sides[0], centre + sides[1]), (height, ceiling), BASE_COLOUR, label)
    for body in scene.inclusion:
        crosses = abs(body.y - scene.placement.y) < _find_radius(body)
        axes.add_patch(
            Circle(
                (body.x * MM_PER_M, -body.depth * MM_PER_M), _find_radius(body) * MM_PER_M, facecolor=TUMOUR_COLOUR,
                edgecolor=TUMOUR_COLOUR, fill=crosses, label=f"tumour, {format_modulus(body.youngs_modulus)}",
            )
        )  # fmt: skip
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel("x, mm")
    axes.set_ylabel("z, mm")
    handles, labels = axes.get_legend_handles_labels()
    unique: dict[str, Patch] = dict(zip(labels, handles, strict=True))  # type: ignore[arg-type]
    axes.legend(unique.values(), unique.keys(), loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8)
    return figure


def _find_radius(body: Inclusion) -> float:
    """Return the radius that is drawn, m: of a body from a file, whose size is in its file, half its depth."""
    if body.diameter is not None:
        return body.diameter / 2
    return body.depth / 2 if body.diameters is None else float(np.mean(body.diameters)) / 2


def _draw_box(axes: Axes, sides: tuple[float, float], levels: tuple[float, float], colour: str, label: str) -> None:
    """Draw a rectangle between two sides and two levels, m, with its name in the legend."""
    corner = sides[0] * MM_PER_M, levels[0] * MM_PER_M
    size = (sides[1] - sides[0]) * MM_PER_M, (levels[1] - levels[0]) * MM_PER_M
    axes.add_patch(Rectangle(corner, *size, facecolor=colour, edgecolor="none", label=label or "_"))
