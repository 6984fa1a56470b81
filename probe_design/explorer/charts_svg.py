"""Draw the small curves of each output against each variable, and the map of detection, as SVG."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.scenes.scene import Scene
from geometry.scenes.units import MM_PER_M
from probe_design.explorer.formats import LABELS, UNITS
from probe_design.explorer.quick import Curve, DetectionMap

WIDTH, HEIGHT, MARGIN = 96, 46, 4  # px of a small curve
NAME_WIDTH = 122  # px of the column of names
MAP_SIZE = 300  # px of the map's sides
UNFIT = ("unfit", "does not fit, or is refused")
VERDICTS = {1.0: ("detected", "detected"), 0.5: ("open", "left open by the error"), 0.0: ("missed", "not detected")}


def draw_curves(curves: Sequence[Curve], outputs: Sequence[str]) -> str:
    """Return a table of small curves: a row for each variable, a column for each output, all of a column on one scale."""
    width, height = NAME_WIDTH + len(outputs) * WIDTH, 16 + len(curves) * HEIGHT
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" class="curves" role="img" viewBox="0 0 {width} {height}" '
             f'aria-label="outputs against each variable">']  # fmt: skip
    for column, name in enumerate(outputs):
        left = NAME_WIDTH + column * WIDTH
        parts.append(f'<text x="{left + WIDTH / 2}" y="11" text-anchor="middle">{LABELS[name]}</text>')
        values = np.array([curve.outputs[name][:, 0] for curve in curves])
        low, high = _find_range(values)
        unit, factor = UNITS.get(name, ("", 1.0))
        for row, curve in enumerate(curves):
            top = 16 + row * HEIGHT
            title = f"{LABELS[name]} {factor * low:.3g} to {factor * high:.3g} {unit} against {curve.variable.label}"
            parts.append(f'<g transform="translate({left},{top})"><title>{title}</title>')
            parts.append(_draw_curve(curve.outputs[name], low, high) + "</g>")
    for row, curve in enumerate(curves):
        variable, y = curve.variable, 16 + row * HEIGHT + HEIGHT / 2
        span = f"{variable.format_value(float(f'{curve.x[0]:.3g}'))} to {variable.format_value(float(f'{curve.x[-1]:.3g}'))}"
        parts.append(
            f'<text x="2" y="{y - 2:.4g}">{variable.label}</text><text x="2" y="{y + 11:.4g}" class="small">{span}</text>'
        )
    return "".join(parts) + "</svg>"


def draw_map(result: DetectionMap, scene: Scene) -> str:
    """Return the map of detected tumours over diameter and depth, with a cross for the present one."""
    rows, columns = result.verdicts.shape
    size, left, top = MAP_SIZE / max(rows, columns), 40, 6
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" class="map" role="img" viewBox="0 0 {MAP_SIZE + 52} {MAP_SIZE + 78}" '
             f'aria-label="tumours detected over depth and diameter">']  # fmt: skip
    for (row, column), verdict in np.ndenumerate(result.verdicts):
        kind, words = VERDICTS.get(float(verdict), UNFIT)
        title = f"{MM_PER_M * result.diameters[column]:.3g} mm at {MM_PER_M * result.depths[row]:.3g} mm: {words}"
        x, y = left + column * size, top + row * size
        parts.append(
            f'<rect class="{kind}" x="{x:.4g}" y="{y:.4g}" width="{size:.4g}" height="{size:.4g}"><title>{title}</title></rect>'
        )
        if kind == "open":  # a second sign beside the colour
            parts.append(f'<text x="{x + size / 2:.4g}" y="{y + 0.68 * size:.4g}" class="mark" text-anchor="middle">?</text>')
    body = scene.inclusion[scene.target or 0]
    x = left + size * _find_cell(result.diameters, body.diameter or 0.0)
    y = top + size * _find_cell(result.depths, body.depth)
    if left <= x <= left + MAP_SIZE and top <= y <= top + MAP_SIZE:
        parts.append(_draw_cross(x, y))
    bottom = top + MAP_SIZE + 13
    for k, anchor, place in ((0, "start", 0), (-1, "end", MAP_SIZE)):
        diameter, depth = MM_PER_M * result.diameters[k], MM_PER_M * result.depths[k]
        parts.append(f'<text x="{left + place}" y="{bottom}" text-anchor="{anchor}">{diameter:.3g}</text>')
        parts.append(f'<text x="{left - 4}" y="{top + max(place, 10)}" text-anchor="end">{depth:.3g}</text>')
    parts.append(f'<text x="{left + MAP_SIZE / 2}" y="{bottom}" text-anchor="middle">diameter, mm</text>')
    parts.append(f'<text transform="translate(12,{top + MAP_SIZE / 2}) rotate(-90)" text-anchor="middle">depth, mm</text>')
    places = ((left, 0), (left + 74, 0), (left + 216, 0), (left, 16))
    for (x, y), (kind, words) in zip(places, (*VERDICTS.values(), UNFIT), strict=True):
        parts.append(f'<rect class="{kind}" x="{x}" y="{bottom + y + 12}" width="11" height="11"/>')
        parts.append(f'<text x="{x + 15}" y="{bottom + y + 22}">{words}</text>')
    parts.append(f'{_draw_cross(left + 221, bottom + 33)}<text x="{left + 234}" y="{bottom + 38}">this tumour</text>')
    return "".join(parts) + "</svg>"


def _draw_cross(x: float, y: float) -> str:
    """Return a cross with a light rim, which is seen on every colour."""
    path = f"M{x - 7:.4g} {y:.4g}h14m-7 -7v14"
    return f'<path class="rim" d="{path}"/><path class="here" d="{path}"/>'


def _find_range(values: Floats) -> tuple[float, float]:
    """Return the range of finite values, widened where it is nothing."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    room = max(0.02 * (high - low), 1e-3 * max(abs(low), abs(high)), 1e-12)
    return low - room, high + room


def _draw_curve(table: Floats, low: float, high: float) -> str:
    """Return one curve with the band of its errors; a dot is the present design, a cross a refused one."""
    values, errors = table[:, 0], table[:, 1]
    known: Bools = np.isfinite(values)
    x = MARGIN + (WIDTH - 2 * MARGIN) * np.linspace(0, 1, len(values))

    def place(numbers: Floats) -> Floats:
        """Return the height of numbers on the picture, px."""
        inside = np.clip(numbers, low, high)
        return np.asarray(HEIGHT - MARGIN - (HEIGHT - 2 * MARGIN) * (inside - low) / (high - low))

    def join(places: Floats, heights: Floats) -> str:
        """Return points as SVG writes them."""
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(places.tolist(), heights.tolist(), strict=True))

    parts = [f'<rect class="frame" width="{WIDTH}" height="{HEIGHT}"/>']
    banded = known & np.isfinite(errors)
    upper, lower = place(values[banded] + errors[banded]), place(values[banded] - errors[banded])
    parts.append(f'<polygon class="band" points="{join(x[banded], upper)} {join(x[banded][::-1], lower[::-1])}"/>')
    parts.append(f'<polyline class="line" points="{join(x[known], place(values[known]))}"/>')
    middle = len(values) // 2
    if known[middle]:
        parts.append(f'<circle class="dot" cx="{x[middle]:.1f}" cy="{float(place(values[middle : middle + 1])[0]):.1f}" r="3"/>')
    parts += [
        f'<text class="refused" x="{item:.1f}" y="{HEIGHT - 6}" text-anchor="middle">×</text>' for item in x[~known].tolist()
    ]
    return "".join(parts)


def _find_cell(axis: Floats, value: float) -> float:
    """Return where a value stands on an evenly spaced axis, in cells from the first one's edge."""
    return float((value - axis[0]) / (axis[1] - axis[0]) + 0.5)
