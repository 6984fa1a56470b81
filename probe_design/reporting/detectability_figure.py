"""Draw the maps of detection and resolution over diameter and depth."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LogNorm, SymLogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from geometry.common.arrays import Floats
from geometry.scenes.scene import Scene
from geometry.scenes.units import MM_PER_M
from probe_design.maps.detectability import Detectability
from probe_design.maps.target_grid import find_target

COLOUR_RANGE_FACTOR = 100.0  # ratio of either end of the colour scale to the threshold


def draw_detectability(maps: Detectability, scene: Scene) -> Figure:
    """Draw the map of the ratio's change and that of the standard deviation of ln E_object, side by side; return the figure."""
    figure = Figure(figsize=(11.0, 5.6), dpi=130, facecolor="white", layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    change, deviation = np.array(maps.change, dtype=float) * 100, np.array(maps.standard_deviation, dtype=float)
    threshold, max_deviation = maps.seen_threshold * 100, maps.resolved_threshold
    ratio = "ratio" if maps.observable == "stress" else "ratio of charges"
    # the colours reach at least three times the threshold, even if no tumour changes the ratio so much
    max_change = max(float(np.nanmax(np.abs(change), initial=0.0)), 3 * threshold)
    norms = (
        SymLogNorm(threshold / 3, vmin=-max_change, vmax=max_change),
        LogNorm(max_deviation / COLOUR_RANGE_FACTOR, max_deviation * COLOUR_RANGE_FACTOR),
    )
    _draw_map(figure, left, maps, change, norm=norms[0], colours="RdBu_r", label=f"change of the {ratio}, %")
    label = "standard deviation of ln E_object, one reading"
    _draw_map(figure, right, maps, deviation, norm=norms[1], colours="viridis_r", label=label)
    for axes, verdicts, values, limit, text in (
        (left, maps.seen, np.abs(change), threshold, f"detected: |change| \u2265 {threshold:.3g} %"),
        (right, maps.resolved, deviation, max_deviation, f"resolved: standard deviation \u2264 {max_deviation:.3g}"),
    ):
        _draw_contour(axes, maps, values, limit)
        _hatch_open_verdicts(axes, maps, verdicts)
        axes.set_title(text, fontsize=10)
        axes.set_xlabel("diameter, mm")
        _mark_target(axes, maps, scene)
    left.set_ylabel("depth of the centre, mm")
    left.invert_yaxis()
    body, offset = find_target(scene), _compute_offset(scene)
    place_text = "on the probe's axis" if offset == 0 else f"{offset * MM_PER_M:.3g} mm off the probe's axis"
    figure.suptitle(
        f"spheres of {body.youngs_modulus / 1e3:.4g} kPa in tissue of {_describe_moduli(scene)} kPa {place_text}, "
        f"noise {maps.noise * 100:.3g} % on the {ratio}",
        fontsize=11,
    )
    _draw_legend(figure)
    return figure


def _describe_moduli(scene: Scene) -> str:
    """Return the moduli of the tissue's materials from the surface downwards, kPa, as text."""
    return " on ".join(f"{material.youngs_modulus / 1e3:.4g}" for material in (*scene.tissue.layer, scene.tissue))


def _compute_offset(scene: Scene) -> float:
    """Return the lateral offset of the target from the probe's axis, m."""
    body, placement = find_target(scene), scene.placement
    return float(np.hypot(body.x - placement.x, body.y - placement.y))


def _draw_map(figure: Any, axes: Any, maps: Detectability, values: Floats, *, norm: Any, colours: str, label: str) -> None:
    """Draw values at all depths and diameters in colours, grey where none, with their scale labelled ``label``."""
    axes.set_facecolor("0.85")
    palette = colormaps[colours].copy()
    image = axes.pcolormesh(
        _convert_to_mm(maps.diameter), _convert_to_mm(maps.depth), values, norm=norm, cmap=palette, shading="nearest"
    )
    bar = figure.colorbar(image, ax=axes, label=label, extend="both" if norm.vmin > 0 else "neither", format="%g")
    bar.ax.minorticks_off()


def _draw_contour(axes: Axes, maps: Detectability, values: Floats, limit: float) -> None:
    """Draw the line on which values equal the limit, interpolated in their logarithm; none if all are on one side."""
    log_ratio_to_limit = np.log(np.maximum(values, 1e-300) / limit)
    if np.any(log_ratio_to_limit < 0) and np.any(log_ratio_to_limit > 0):
        axes.contour(
            _convert_to_mm(maps.diameter),
            _convert_to_mm(maps.depth),
            np.ma.masked_invalid(log_ratio_to_limit),
            levels=[0.0],
            colors="black",
            linewidths=1.6,
        )


def _hatch_open_verdicts(axes: Axes, maps: Detectability, verdicts: Any) -> None:
    """Hatch the cells where the error bound leaves the verdict open, or is above the change.

    ``verdicts`` are whether tumours are detected, or resolved, at each depth (rows) and diameter: true, false, or None for open.
    """
    fits = np.isfinite(np.array(maps.change, dtype=float))
    hidden = fits & (np.isnan(np.array(verdicts, dtype=float)) | (np.array(maps.above_error, dtype=float) == 0))
    x, y = (_compute_edges(_convert_to_mm(values)) for values in (maps.diameter, maps.depth))
    cells = [
        [(x[m], y[k]), (x[m + 1], y[k]), (x[m + 1], y[k + 1]), (x[m], y[k + 1])] for k, m in zip(*np.nonzero(hidden), strict=True)
    ]
    axes.add_collection(PolyCollection(cells, facecolor="none", edgecolor="0.15", linewidth=0, hatch="xxxx"), autolim=False)


def _compute_edges(centres: Floats) -> Floats:
    """Return the n + 1 edges of cells around n evenly spaced centres."""
    middles = (centres[1:] + centres[:-1]) / 2
    return np.concatenate([[2 * centres[0] - middles[0]], middles, [2 * centres[-1] - middles[-1]]])


def _mark_target(axes: Axes, maps: Detectability, scene: Scene) -> None:
    """Mark size and depth of the scene's own target, if the map contains them."""
    body = find_target(scene)
    x, y = (body.diameter or 0.0) * MM_PER_M, body.depth * MM_PER_M
    if (
        maps.diameter[0] * MM_PER_M <= x <= maps.diameter[-1] * MM_PER_M
        and maps.depth[0] * MM_PER_M <= y <= maps.depth[-1] * MM_PER_M
    ):
        axes.plot(x, y, marker="*", markersize=15, markerfacecolor="gold", markeredgecolor="black", linestyle="none")


def _draw_legend(figure: Any) -> None:
    """Explain line, star and hatching below both maps."""
    star = Line2D([], [], marker="*", markersize=12, markerfacecolor="gold", markeredgecolor="black", linestyle="none")
    handles = [
        (Line2D([], [], color="black", linewidth=1.6), "threshold"),
        (star, "the scene's tumour"),
        (Patch(facecolor="0.85", edgecolor="0.6"), "does not fit into the tissue"),
        (Patch(facecolor="white", edgecolor="0.3", hatch="xxxx"), "the model's error hides it"),
    ]
    figure.legend(*zip(*handles, strict=True), loc="outside lower center", ncols=4, fontsize=9)


def _convert_to_mm(values: tuple[float, ...]) -> Floats:
    """Convert lengths in m to an array in mm."""
    return np.array(values) * MM_PER_M
