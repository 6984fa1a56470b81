"""Draw a scan: ratio and log-sensitivity above a section of the tissue, true to scale."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion
from geometry.scenes.units import MM_PER_M
from probe_design.maps.scan import Scan

FIGURE_WIDTH_IN, LEFT_MARGIN_IN, RIGHT_MARGIN_IN = 9.0, 0.95, 0.25  # of the figure and its margins, inches
CURVE_HEIGHT_IN, GAP_HEIGHT_IN, TOP_MARGIN_IN, BOTTOM_MARGIN_IN = 2.2, 0.22, 0.2, 0.6  # heights, inches
MAX_SECTION_HEIGHT_IN = 5.5  # section, inches
TISSUE_COLOUR, STIFF_COLOUR, SOFT_COLOUR, INNER_COLOUR, OUTER_COLOUR = "#f6d9c4", "#a33b2e", "#3f7fb5", "#4d6f9a", "#8fb0d3"


def draw_scan(scan: Scan, scene: Scene) -> Figure:
    """Draw a scan of a scene; return the figure."""
    low, high, depth = _choose_window(scan, scene)
    axes_width = FIGURE_WIDTH_IN - LEFT_MARGIN_IN - RIGHT_MARGIN_IN
    height_above = max(scene.probe.core_height, scene.probe.tube_height) * MM_PER_M * 1.25
    section_height = (depth + height_above) * axes_width / (high - low)
    heights = [CURVE_HEIGHT_IN, CURVE_HEIGHT_IN, section_height]
    figure_height = BOTTOM_MARGIN_IN + TOP_MARGIN_IN + sum(heights) + 2 * GAP_HEIGHT_IN
    figure = Figure(figsize=(FIGURE_WIDTH_IN, figure_height), dpi=130, facecolor="white")
    base, axes = BOTTOM_MARGIN_IN, []
    for height in reversed(heights):
        axes.append(
            figure.add_axes(
                (LEFT_MARGIN_IN / FIGURE_WIDTH_IN, base / figure_height, axes_width / FIGURE_WIDTH_IN, height / figure_height)
            )
        )
        base += height + GAP_HEIGHT_IN
    section_axes, middle_axes, ratio_axes = axes
    _plot_ratio(ratio_axes, scan)
    _plot_second_curve(middle_axes, scan)
    _draw_section(section_axes, scan, scene, depth)
    section_axes.set(xlim=(low, high), ylim=(-depth, height_above))
    probe_position = _choose_probe_position(scan) * MM_PER_M
    for curve_axes in (ratio_axes, middle_axes):
        curve_axes.set(xlim=(low, high))
        curve_axes.tick_params(labelbottom=False)
        curve_axes.grid(alpha=0.3)
        curve_axes.axvline(probe_position, color="0.5", linestyle="--", linewidth=0.8)
    cross_axis = "y" if scan.along == "x" else "x"
    ratio_axes.set_title(
        f"{scan.evaluator}: {len(scan.position)} positions along {scan.along} at {cross_axis} = {scan.at * MM_PER_M:.4g} mm "
        f"in {scan.seconds:.2g} s",
        fontsize=10,
    )
    ratio_axes.legend(loc="best", fontsize=8)
    return figure


def _choose_window(scan: Scan, scene: Scene) -> tuple[float, float, float]:
    """Return lower and upper end of the picture along the line of the scan, and its depth, mm.

    It shows the probe at all positions and the inclusions below them; the margins are some per cent of their sizes.
    """
    reach = scene.probe.tube_radius
    low, high = min(scan.position) - 1.15 * reach, max(scan.position) + 1.15 * reach
    bodies = [body for body in scene.inclusion if low - _get_radius(body) < getattr(body, scan.along) < high + _get_radius(body)]
    depth = max([2 * reach, *(1.15 * (body.depth + _get_radius(body)) for body in bodies)])
    depth = min(depth, 1.03 * scene.tissue.bottom)
    min_width = (
        depth * (FIGURE_WIDTH_IN - LEFT_MARGIN_IN - RIGHT_MARGIN_IN) / MAX_SECTION_HEIGHT_IN
    )  # a wider window where the section would become too tall
    extra = max(0.0, min_width - (high - low)) / 2
    return (low - extra) * MM_PER_M, (high + extra) * MM_PER_M, depth * MM_PER_M


def _get_radius(body: Inclusion) -> float:
    """Return the radius of a sphere, m; 0 for other bodies."""
    return (body.diameter or 0.0) / 2


def _choose_probe_position(scan: Scan) -> float:
    """Return the position at which the probe is drawn: where inclusions change the ratio most."""
    ratio = np.array(scan.reading.ratio, dtype=float)
    ratio_without = np.nan if scan.reading_without is None else scan.reading_without
    change = np.abs(ratio - ratio_without)
    if not np.any(change > 1e-9 * np.abs(ratio_without)):
        return scan.position[len(scan.position) // 2]
    return scan.position[int(np.nanargmax(change))]


def _plot_ratio(axes: Axes, scan: Scan) -> None:
    """Plot the ratio with its error band, and the ratio without inclusions."""
    x = np.array(scan.position) * MM_PER_M
    read = scan.reading
    ratio, error = (np.array(values, dtype=float) for values in (read.ratio, read.error))  # NaN where a value is None
    axes.plot(x, ratio, color="tab:blue", marker="." if len(x) < 60 else None, label="with inclusions")
    band = np.abs(ratio) * np.minimum(error, 1.0)
    axes.fill_between(x, ratio - band, ratio + band, color="tab:blue", alpha=0.2, linewidth=0, label="bound on the error")
    if scan.reading_without is not None:
        axes.axhline(scan.reading_without, color="0.35", linewidth=0.9, linestyle=":", label="without any")
    if not np.any(np.isfinite(ratio)):
        axes.text(
            0.5, 0.5, f"null: a {scan.observable} is below its own error", transform=axes.transAxes, ha="center", va="center"
        )
    low, high = axes.get_ylim()
    middle = (low + high) / 2
    if high - low < 1e-3 * abs(middle):  # a flat line stays one
        axes.set_ylim(middle - 5e-3 * abs(middle), middle + 5e-3 * abs(middle))
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.set_ylabel(f"ratio of inner to\nouter film {scan.observable}")


def _plot_second_curve(axes: Axes, scan: Scan) -> None:
    """Plot the log-sensitivity if there is a target, else the stiffness."""
    x = np.array(scan.position) * MM_PER_M
    sensitivity = np.array(scan.reading.log_sensitivity, dtype=float)
    if np.any(np.isfinite(sensitivity)):
        axes.plot(x, sensitivity, color="tab:orange", marker="." if len(x) < 60 else None)
        axes.axhline(0.0, color="0.7", linewidth=0.8)
        axes.set_ylabel("log-sensitivity of the target\nd ln ratio / d ln E")
        return
    stiffness = np.array(scan.stiffness)
    axes.plot(x, stiffness, color="tab:green", marker="." if len(x) < 60 else None)
    if np.ptp(stiffness) < 1e-3 * stiffness.max():
        axes.set_ylim(0.995 * stiffness.min(), 1.005 * stiffness.max())
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.set_ylabel("stiffness, N/m\n(force per indentation)")


def _draw_section(axes: Axes, scan: Scan, scene: Scene, depth: float) -> None:
    """Draw the section of the tissue along the line, with inclusions and probe."""
    left, right = _find_sides(scan, scene, 10 * depth + 1e3)
    floor = min(depth, scene.tissue.bottom * MM_PER_M)
    axes.add_patch(Rectangle((left, -floor), right - left, floor, facecolor=TISSUE_COLOUR, edgecolor="none"))
    axes.plot([left, left, right, right], [-floor, 0, 0, -floor], color="0.35", linewidth=1.0)
    if floor < depth:
        axes.axhspan(-depth, -floor, facecolor="0.75", hatch="///", edgecolor="0.5", linewidth=0)
    cross_axis = "y" if scan.along == "x" else "x"
    sorted_bodies = sorted(scene.inclusion, key=lambda body: -abs(getattr(body, cross_axis) - scan.at))
    for body in sorted_bodies:
        colour = STIFF_COLOUR if body.youngs_modulus >= scene.tissue.find_material(body.depth).youngs_modulus else SOFT_COLOUR
        centre = (getattr(body, scan.along) * MM_PER_M, -body.depth * MM_PER_M)
        lateral_offset = abs(getattr(body, cross_axis) - scan.at)
        radius = _get_radius(body)
        is_target = scene.target is not None and body is scene.inclusion[scene.target]
        edge = {"edgecolor": colour, "linewidth": 1.6 if is_target else 0.9}
        axes.add_patch(
            Circle(centre, radius * MM_PER_M, facecolor="none", linestyle="-" if lateral_offset == 0 else "--", **edge)
        )
        if lateral_offset < radius:  # the line crosses the sphere: its section is a smaller circle
            cut = math.sqrt(radius**2 - lateral_offset**2) * MM_PER_M
            axes.add_patch(Circle(centre, cut, facecolor=colour, alpha=0.55, edgecolor="none"))
        _write_label(axes, centre, radius * MM_PER_M, _describe_body(body, lateral_offset, is_target), colour)
    _draw_probe(axes, scene, _choose_probe_position(scan) * MM_PER_M)
    axes.set_xlabel(f"position along {scan.along}, mm")
    axes.set_ylabel("depth, mm (true to scale)")
    axes.yaxis.set_major_formatter(lambda height, _: f"{abs(height):g}" if height < 1e-9 else "")


def _write_label(axes: Axes, centre: tuple[float, float], radius: float, text: str, colour: str) -> None:
    """Write a text below an inclusion with its centre and radius in mm."""
    white = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.8}
    axes.annotate(
        text, (centre[0], centre[1] - radius), xytext=(0, -3), textcoords="offset points", ha="center", va="top", fontsize=8,
        color=colour, bbox=white, annotation_clip=True, zorder=5,
    )  # fmt: skip


def _describe_body(body: Inclusion, lateral_offset: float, is_target: bool) -> str:
    """Describe an inclusion: its modulus, whether it is the target, and its distance from the line."""
    modulus, unit = (body.youngs_modulus / 1e3, "kPa") if body.youngs_modulus < 1e6 else (body.youngs_modulus / 1e6, "MPa")
    text = f"{modulus:.3g} {unit}"
    if is_target:
        text += ", target"
    return text if lateral_offset == 0 else f"{text}, {lateral_offset * MM_PER_M:.3g} mm off the line"


def _find_sides(scan: Scan, scene: Scene, far_side: float) -> tuple[float, float]:
    """Return the coordinates along the line at which it leaves the tissue, mm; ± ``far_side`` in a half-space."""
    tissue = scene.tissue
    if tissue.shape == "cylinder":
        half = math.sqrt(tissue.radius**2 - scan.at**2) * MM_PER_M
    elif tissue.shape == "block":
        half = (tissue.length if scan.along == "x" else tissue.breadth) / 2 * MM_PER_M
    else:
        half = far_side
    return -half, half


def _draw_probe(axes: Axes, scene: Scene, position: float) -> None:
    """Draw the section of the probe at a position along the line, mm."""
    probe = scene.probe
    inner, hole, outer = (radius * MM_PER_M for radius in (probe.inner_radius, probe.hole_radius, probe.tube_radius))

    def draw_block(left: float, width: float, height: float, colour: str) -> None:
        """Draw one rectangle of a block, from its left edge, mm."""
        axes.add_patch(Rectangle((left, 0), width, height * MM_PER_M, facecolor=colour, edgecolor="0.2", linewidth=0.6, zorder=6))

    for start in (position - outer, position + hole):
        draw_block(start, outer - hole, probe.tube_height, OUTER_COLOUR)
    draw_block(position - inner, 2 * inner, probe.core_height, INNER_COLOUR)
    axes.axvline(position, color="0.5", linestyle="--", linewidth=0.8)
