"""Draw the section of a design to scale as SVG, in mm, so that the page can move its tumours."""

from __future__ import annotations

import math
from itertools import pairwise

from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import BlockTissue, CylinderTissue, Inclusion
from geometry.scenes.units import MM_PER_M, format_modulus
from probe_design.explorer.edges import draw_edges

PROBE_RADII, TUMOUR_DEPTHS = 2.2, 1.4  # relative: shown to each side of the probe, and of the depth of the deepest tumour
VIEW_STEP = 1.25  # relative: the view grows by this factor, so that it stands still while a tumour is dragged within it
BASE_HEIGHT_RADII = 0.12  # relative: of the base that is drawn
STYLE = """
.base{fill:#495057}.inner{fill:#2a6f97}.outer{fill:#61a5c2}.tissue{fill:#f6d5c3}.layer{fill:#eebfa5}.layer.odd{fill:#e5a98a}
.tumour{fill:#9d0208;stroke:#fff}.tumour.aside{fill:none;stroke:#9d0208;stroke-dasharray:1 .6}
.edge{stroke:#000;stroke-opacity:0;stroke-width:8px;vector-effect:non-scaling-stroke}
text{font-family:system-ui,sans-serif;fill:#212529}.on-dark{fill:#fff}
"""


def draw_section(scene: Scene) -> str:
    """Return the section in the plane of the probe's axis and the x-axis as SVG; tumours beside it in outline.

    Its coordinates are x and depth in mm. A tumour is marked with ``data-tumour``, its index, which the page's script moves.
    """
    probe, tissue, centre = scene.probe, scene.tissue, MM_PER_M * scene.placement.x
    outer = MM_PER_M * probe.tube_radius
    top = MM_PER_M * max(probe.core_height, probe.tube_height)
    base = BASE_HEIGHT_RADII * outer
    deepest = max([TUMOUR_DEPTHS * body.depth for body in scene.inclusion] + [2 * probe.tube_radius])
    depth = _round_up(MM_PER_M * deepest)
    reach = _round_up(
        max([PROBE_RADII * outer] + [abs(MM_PER_M * (body.x + _find_radius(body)) - centre) for body in scene.inclusion])
    )
    half = math.inf
    if isinstance(tissue, CylinderTissue | BlockTissue):
        depth = min(depth, MM_PER_M * tissue.depth)
        half = MM_PER_M * (tissue.radius if isinstance(tissue, CylinderTissue) else tissue.length / 2)
    left, right = max(centre - reach, -half), min(centre + reach, half)
    size = (reach + depth) / 36  # of a text
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" class="section" role="group" aria-label="probe and tissue, to scale" '
        f'viewBox="{centre - reach:.4g} {-top - base - size:.5g} {2 * reach:.5g} {depth + top + base + 2.8 * size:.5g}">'
        f"<style>{STYLE}</style>"
    ]
    levels = (0.0, *(MM_PER_M * level for level in tissue.interfaces if MM_PER_M * level < depth), depth)
    for k, (upper, lower) in enumerate(pairwise(levels)):
        kind = "tissue" if k == len(levels) - 2 else f"layer{' odd' if k % 2 else ''}"
        modulus = format_modulus(tissue.find_material((upper + lower) / 2 / MM_PER_M).youngs_modulus)
        parts.append(_draw_box(left, right, upper, lower, kind))
        parts.append(_write_text(left + size / 2, lower - size / 2, size, f"{kind.split()[0]} {modulus}"))
    inner, hole = MM_PER_M * probe.inner_radius, MM_PER_M * probe.hole_radius
    parts.append(_draw_box(centre - outer, centre + outer, -top - base, -top, "base"))
    for start, end, height, kind in (
        (-inner, inner, probe.core_height, "inner"),
        (-outer, -hole, probe.tube_height, "outer"),
        (hole, outer, probe.tube_height, "outer"),
    ):
        parts.append(_draw_box(centre + start, centre + end, -MM_PER_M * height, 0.0, kind))
        if top > MM_PER_M * height:  # the base reaches down to the shorter block
            parts.append(_draw_box(centre + start, centre + end, -top, -MM_PER_M * height, "base"))
    parts.append(draw_edges(scene))
    parts += [_draw_tumour(k, body) for k, body in enumerate(scene.inclusion)]
    bar = 10 ** math.floor(math.log10(reach))
    start, y = right - bar - size, depth + size / 3
    parts.append(f'<path d="M{start:.4g} {y:.5g}h{bar:g}" stroke="currentColor" stroke-width="{size / 8:.3g}"/>')
    parts.append(_write_text(start, depth + 1.3 * size, size, f"{bar:g} mm", "scale"))
    return "".join(parts) + "</svg>"


def _draw_box(left: float, right: float, top: float, bottom: float, kind: str) -> str:
    """Return a rectangle, mm."""
    return f'<rect class="{kind}" x="{left:.5g}" y="{top:.5g}" width="{right - left:.5g}" height="{bottom - top:.5g}"/>'


def _write_text(x: float, y: float, size: float, text: str, kind: str = "name") -> str:
    """Return a text at a place, mm."""
    return f'<text class="{kind}" x="{x:.5g}" y="{y:.5g}" font-size="{size:.3g}">{text}</text>'


def _draw_tumour(index: int, body: Inclusion) -> str:
    """Return a tumour that can be dragged, and moved by the arrow keys."""
    radius = MM_PER_M * _find_radius(body)
    aside = " aside" if abs(body.y) > _find_radius(body) else ""
    x, depth = MM_PER_M * body.x, MM_PER_M * body.depth
    return (
        f'<circle class="tumour{aside}" data-tumour="{index}" tabindex="0" role="slider" aria-label="tumour {index + 1}: '
        f'drag it, or move it by the arrow keys" aria-valuetext="x {x:.4g} mm, depth {depth:.4g} mm" '
        f'aria-valuenow="{depth:.4g}" cx="{x:.5g}" cy="{depth:.5g}" r="{radius:.5g}" stroke-width="{radius / 15:.3g}"/>'
    )


def _find_radius(body: Inclusion) -> float:
    """Return half the diameter of a body, or half the mean of its three, m."""
    diameters = [body.diameter] if body.diameter is not None else list(body.diameters or (0.0,))
    return sum(diameters) / len(diameters) / 2


def _round_up(length: float) -> float:
    """Return the next step of the view, mm."""
    return float(VIEW_STEP ** math.ceil(math.log(max(length, 1e-6), VIEW_STEP) - 1e-9))
