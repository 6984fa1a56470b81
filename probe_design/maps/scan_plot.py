"""Draw a scan: ratio and log-sensitivity above a section of the tissue, true to scale."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Inclusion, Scene
from probe_design.maps.scan import Column, Scan
from probe_design.pictures.formats import check_format, save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MM = 1e3
WIDTH, LEFT, RIGHT = 9.0, 0.95, 0.25  # of the figure and its margins, inches
CURVE, SPACE, TOP, BOTTOM = 2.2, 0.22, 0.2, 0.6  # heights, inches
TALLEST = 5.5  # section, inches
TISSUE, STIFF, SOFT, INNER, OUTER = "#f6d9c4", "#a33b2e", "#3f7fb5", "#4d6f9a", "#8fb0d3"


def plot(scan: Scan, scene: Scene, path: Path) -> Path:
    """Draw a scan of a scene to a file; return ``path``.

    Raises:
        InputError: see ``check_format``.
        OSError: the file cannot be written.
    """
    check_format(path)
    return save(figure_of(scan, scene), path)


def figure_of(scan: Scan, scene: Scene) -> Figure:
    """Draw a scan of a scene; return the figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    low, high, deep = _window(scan, scene)
    room = WIDTH - LEFT - RIGHT
    above = max(scene.probe.core_height, scene.probe.tube_height) * MM * 1.25
    section = (deep + above) * room / (high - low)
    heights = [CURVE, CURVE, section]
    tall = BOTTOM + TOP + sum(heights) + 2 * SPACE
    figure = Figure(figsize=(WIDTH, tall), dpi=130, facecolor="white")
    FigureCanvasAgg(figure)
    base, axes = BOTTOM, []
    for height in reversed(heights):
        axes.append(figure.add_axes((LEFT / WIDTH, base / tall, room / WIDTH, height / tall)))
        base += height + SPACE
    below, middle, top = axes
    _ratio(top, scan)
    _second(middle, scan)
    _section(below, scan, scene, deep)
    below.set(xlim=(low, high), ylim=(-deep, above))
    shown = _shown(scan) * MM
    for one in (top, middle):
        one.set(xlim=(low, high))
        one.tick_params(labelbottom=False)
        one.grid(alpha=0.3)
        one.axvline(shown, color="0.5", linestyle="--", linewidth=0.8)
    across = "y" if scan.along == "x" else "x"
    top.set_title(
        f"{scan.evaluator}: {len(scan.position)} positions along {scan.along} at {across} = {scan.at * MM:.4g} mm "
        f"in {scan.seconds:.2g} s",
        fontsize=10,
    )
    top.legend(loc="best", fontsize=8)
    return figure


def _window(scan: Scan, scene: Scene) -> tuple[float, float, float]:
    """Return lower and upper end of the picture along the line, and its depth, mm."""
    reach = scene.probe.tube_radius
    low, high = min(scan.position) - 1.15 * reach, max(scan.position) + 1.15 * reach
    bodies = [body for body in scene.inclusion if low < getattr(body, scan.along) + _radius(body) and _left(body, scan) < high]
    deep = max([2 * reach, *(1.15 * (body.depth + _radius(body)) for body in bodies)])
    if scene.tissue.shape != "half-space":
        deep = min(deep, 1.03 * scene.tissue.depth)
    least = deep * (WIDTH - LEFT - RIGHT) / TALLEST  # a wider window where the section would become too tall
    extra = max(0.0, least - (high - low)) / 2
    return (low - extra) * MM, (high + extra) * MM, deep * MM


def _radius(body: Inclusion) -> float:
    return (body.diameter or 0.0) / 2


def _left(body: Inclusion, scan: Scan) -> float:
    return float(getattr(body, scan.along)) - _radius(body)


def _shown(scan: Scan) -> float:
    """Return the position at which the probe is drawn: where inclusions change the ratio most."""
    ratio = _numbers(scan.ratio)
    usual = np.nan if scan.ratio_without is None else scan.ratio_without
    change = np.abs(ratio - usual)
    if not np.any(change > 1e-9 * np.abs(usual)):
        return scan.position[len(scan.position) // 2]
    return scan.position[int(np.nanargmax(change))]


def _ratio(axes: Any, scan: Scan) -> None:
    x, ratio, error = np.array(scan.position) * MM, _numbers(scan.ratio), _numbers(scan.error_estimate)
    axes.plot(x, ratio, color="tab:blue", marker="." if len(x) < 60 else None, label="with inclusions")
    band = np.abs(ratio) * np.minimum(error, 1.0)
    axes.fill_between(x, ratio - band, ratio + band, color="tab:blue", alpha=0.2, linewidth=0, label="bound on the error")
    if scan.ratio_without is not None:
        axes.axhline(scan.ratio_without, color="0.35", linewidth=0.9, linestyle=":", label="without any")
    if not np.any(np.isfinite(ratio)):
        axes.text(0.5, 0.5, "null: a stress is below its own error", transform=axes.transAxes, ha="center", va="center")
    low, high = axes.get_ylim()
    middle = (low + high) / 2
    if high - low < 1e-3 * abs(middle):  # a flat line stays one
        axes.set_ylim(middle - 5e-3 * abs(middle), middle + 5e-3 * abs(middle))
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.set_ylabel("ratio of inner to\nouter film stress")


def _second(axes: Any, scan: Scan) -> None:
    """Plot the log-sensitivity if there is a target, else the stiffness."""
    x = np.array(scan.position) * MM
    sensitivity = _numbers(scan.log_sensitivity)
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


def _section(axes: Any, scan: Scan, scene: Scene, deep: float) -> None:
    from matplotlib.patches import Circle, Rectangle

    left, right = _sides(scan, scene, 10 * deep + 1e3)
    floor = min(deep, math.inf if scene.tissue.shape == "half-space" else scene.tissue.depth * MM)
    axes.add_patch(Rectangle((left, -floor), right - left, floor, facecolor=TISSUE, edgecolor="none"))
    axes.plot([left, left, right, right], [-floor, 0, 0, -floor], color="0.35", linewidth=1.0)
    if floor < deep:
        axes.axhspan(-deep, -floor, facecolor="0.75", hatch="///", edgecolor="0.5", linewidth=0)
    across = "y" if scan.along == "x" else "x"
    nearest = sorted(scene.inclusion, key=lambda body: -abs(getattr(body, across) - scan.at))
    for body in nearest:
        colour = STIFF if body.youngs_modulus >= scene.tissue.material_at(body.depth).youngs_modulus else SOFT
        centre, beside = (getattr(body, scan.along) * MM, -body.depth * MM), abs(getattr(body, across) - scan.at)
        radius = _radius(body)
        is_target = scene.target is not None and body is scene.inclusion[scene.target]
        edge = {"edgecolor": colour, "linewidth": 1.6 if is_target else 0.9}
        axes.add_patch(Circle(centre, radius * MM, facecolor="none", linestyle="-" if beside == 0 else "--", **edge))
        if beside < radius:
            cut = math.sqrt(radius**2 - beside**2) * MM
            axes.add_patch(Circle(centre, cut, facecolor=colour, alpha=0.55, edgecolor="none"))
        _name(axes, centre, radius * MM, _label(body, beside, is_target), colour)
    _probe(axes, scene, _shown(scan) * MM)
    axes.set_xlabel(f"position along {scan.along}, mm")
    axes.set_ylabel("depth, mm (true to scale)")
    axes.yaxis.set_major_formatter(lambda height, _: f"{abs(height):g}" if height < 1e-9 else "")


def _name(axes: Any, centre: tuple[float, float], radius: float, text: str, colour: str) -> None:
    white = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.8}
    axes.annotate(
        text, (centre[0], centre[1] - radius), xytext=(0, -3), textcoords="offset points", ha="center", va="top", fontsize=8,
        color=colour, bbox=white, annotation_clip=True, zorder=5,
    )  # fmt: skip


def _label(body: Inclusion, beside: float, is_target: bool) -> str:
    modulus, unit = (body.youngs_modulus / 1e3, "kPa") if body.youngs_modulus < 1e6 else (body.youngs_modulus / 1e6, "MPa")
    text = f"{modulus:.3g} {unit}"
    if is_target:
        text += ", target"
    return text if beside == 0 else f"{text}, {beside * MM:.3g} mm off the line"


def _sides(scan: Scan, scene: Scene, far: float) -> tuple[float, float]:
    """Return the coordinates along the line at which it leaves the tissue, mm."""
    tissue = scene.tissue
    if tissue.shape == "cylinder":
        half = math.sqrt(tissue.radius**2 - scan.at**2) * MM
    elif tissue.shape == "block":
        half = (tissue.length if scan.along == "x" else tissue.breadth) / 2 * MM
    else:
        half = far
    return -half, half


def _probe(axes: Any, scene: Scene, at: float) -> None:
    from matplotlib.patches import Rectangle

    probe = scene.probe
    inner, hole, outer = (radius * MM for radius in (probe.inner_radius, probe.hole_radius, probe.tube_radius))
    edge = {"edgecolor": "0.2", "linewidth": 0.6, "zorder": 6}
    for start in (at - outer, at + hole):
        axes.add_patch(Rectangle((start, 0), outer - hole, probe.tube_height * MM, facecolor=OUTER, **edge))
    axes.add_patch(Rectangle((at - inner, 0), 2 * inner, probe.core_height * MM, facecolor=INNER, **edge))
    axes.axvline(at, color="0.5", linestyle="--", linewidth=0.8)


def _numbers(values: Column) -> Floats:
    return np.array([np.nan if value is None else value for value in values])
