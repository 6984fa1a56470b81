"""Edges of the blocks that can be dragged in the section, and the numbers of the design that follow."""

from __future__ import annotations

from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from geometry.scenes.units import MM_PER_M

RADII = ("inner", "hole", "outer")
HEIGHTS = {"core-top": "probe.inner_height", "tube-top": "probe.outer_height"}


def draw_edges(scene: Scene) -> str:
    """Return all edges as SVG: lines that can be dragged, and moved by the arrow keys."""
    return "".join(_draw_edge(name, *line) for name, line in list_edges(scene).items())


def list_edges(scene: Scene) -> dict[str, tuple[float, float, float, float]]:
    """Return the edges of the blocks that can be dragged, x, y, width and height of each line by its name, mm."""
    probe, centre = scene.probe, MM_PER_M * scene.placement.x
    core, tube = MM_PER_M * probe.core_height, MM_PER_M * probe.tube_height
    inner, hole, outer = (MM_PER_M * radius for radius in (probe.inner_radius, probe.hole_radius, probe.tube_radius))
    return {
        "inner": (centre + inner, -core, 0.0, core),
        "hole": (centre + hole, -tube, 0.0, tube),
        "outer": (centre + outer, -tube, 0.0, tube),
        "core-top": (centre - 0.9 * inner, -core, 1.8 * inner, 0.0),
        "tube-top": (centre + hole, -tube, outer - hole, 0.0),
    }


def find_edge_changes(scene: Scene, name: str, x: float, depth: float) -> dict[str, str]:
    """Return the numbers of the design, by their keys, with which an edge lies at x and depth, mm; other edges stay.

    Raises
    ------
    InputError
        There is no such edge, or it would lie beyond the next one.
    """
    probe, radius = scene.probe, abs(x / MM_PER_M - scene.placement.x)
    if name in HEIGHTS:
        return {"probe.height" if probe.height is not None else HEIGHTS[name]: f"{-depth:.4g} mm"}
    if name not in RADII:
        raise InputError("edge", name, f"one of {', '.join((*RADII, *HEIGHTS))}")
    sizes = dict(zip(RADII, (probe.inner_radius, probe.hole_radius, probe.tube_radius), strict=True)) | {name: radius}
    inner, hole, outer = sizes.values()
    if not 0 < inner < hole < outer:
        raise InputError("edge", f"{MM_PER_M * radius:.4g} mm", f"a radius for the {name} edge that leaves gap and wall")
    lengths = {"probe.inner_radius": inner, "probe.gap": hole - inner}
    if probe.outer_radius is not None:
        lengths["probe.outer_radius"] = outer
    changes = {key: f"{MM_PER_M * length:.5g} mm" for key, length in lengths.items()}
    return changes if probe.outer_radius is not None else changes | {"probe.area_ratio": f"{inner**2 / (outer**2 - hole**2):.6g}"}


def _draw_edge(name: str, x: float, y: float, width: float, height: float) -> str:
    """Return an edge, mm."""
    cursor = "ns-resize" if width else "ew-resize"
    words = f"height of the {'inner' if name == 'core-top' else 'outer'} block" if width else f"radius of the {name} edge"
    return (
        f'<path class="edge" data-edge="{name}" data-x="{x:.5g}" data-y="{y:.5g}" style="cursor:{cursor}" tabindex="0" '
        f'role="slider" aria-label="{words}: drag it, or move it by the arrow keys" aria-valuenow="{abs(y if width else x):.4g}" '
        f'd="M{x:.5g} {y:.5g}h{width:.5g}v{height:.5g}"/>'
    )
