"""Draw the pictures of a report: start and optimum over depth and diameter, gains of improvements, Pareto fronts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, PercentFormatter
from numpy.typing import NDArray

from geometry.common.arrays import Floats
from geometry.scenes.units import MM_PER_M
from probe_design.data.noise import MAX_RESOLVED_LOG_SD
from probe_design.design_report.depth_map import DETECTION_THRESHOLD, DepthMap
from probe_design.design_report.improvements import Improvement
from probe_design.design_search.pareto import Front
from probe_design.design_search.verification import PopulationVerification
from probe_design.populations.objective import Objective
from probe_design.reporting.picture_files import check_format, save_figure

VERIFIED_COLOUR, CLOSED_FORM_COLOUR = "#2a6f97", "#9aa5b1"
MIN_SHOWN_SD, MAX_SHOWN_SD = 0.05, 5.0  # of ln contrast: range of the colours


def draw_maps(maps: dict[str, DepthMap], verified: dict[str, PopulationVerification], path: Path) -> Path:
    """Draw P and the standard deviation of ln contrast over diameter and depth, one column per design; return ``path``.

    Tumours of the verification are points, filled if their probability of detection is above 0.5.
    """
    figure, axes = _create_figure((5.4 * len(maps), 9.0), (2, len(maps)))
    for column, (name, item) in enumerate(maps.items()):
        for row, (values, label, limit) in enumerate(
            (
                (item.probability, "probability of detection", DETECTION_THRESHOLD),
                (item.contrast_sd, "sd of ln contrast (small: stiffness known)", MAX_RESOLVED_LOG_SD),
            )
        ):
            _draw_map(figure, axes[row][column], item, values, label=label, limit=limit)
        axes[0][column].set_title(name, fontsize=11)
        _draw_tumours(axes[0][column], verified[name])
    for row in axes:
        row[0].set_ylabel("depth of the centre, mm")
    for item in axes[-1]:
        item.set_xlabel("diameter, mm")
    figure.suptitle(
        "By the closed form, for a known tumour in the middle of the population's ranges (an upper bound); grey: none fits.\n"
        "Points: tumours verified, white where detected more often than not. Black lines: detected 9 times in 10; ln contrast\n"
        "resolved to 0.5.",
        fontsize=12,
    )
    return save_figure(figure, path)


def draw_front(fronts: tuple[Front, ...], aim: Objective, path: Path) -> Path:
    """Draw Pareto fronts of an objective side by side; return ``path``."""
    figure, axes = _create_figure((5.0 * len(fronts), 4.0), (1, len(fronts)))
    for plot, front in zip(axes[0], fronts, strict=True):
        values = [aim.scale * point.value for point in front.points]
        plot.plot(front.costs, values, "-", color=CLOSED_FORM_COLOUR, label="by the closed form")
        pairs = zip(front.costs, front.points, strict=True)
        verified = [(cost, *(aim.scale * number for number in point.verified)) for cost, point in pairs if point.verified]
        if verified:
            plot.errorbar(*zip(*verified, strict=True), fmt="o", color=VERIFIED_COLOUR, capsize=3, label="verified, one error")
        plot.set_xlabel(front.label)
        plot.set_ylabel(aim.label)
        plot.legend(fontsize=8)
    return save_figure(figure, path)


def draw_improvements(improvements: Sequence[Improvement], aim: Objective, path: Path) -> Path:
    """Draw the gain of each improvement as a bar with two standard errors; return ``path``.

    Parameters
    ----------
    improvements
        Improvements from ``compute_improvements``, the first of which changes nothing.
    aim
        The objective.
    path
        Path of the picture.

    Raises
    ------
    InputError
        The format is not known.
    """
    check_format(path)
    figure, ((axes,),) = _create_figure((8.0, 1.2 + 0.42 * len(improvements)), (1, 1))
    places, values = np.arange(len(improvements)), [aim.scale * item.value for item in improvements]
    axes.barh(places, values, color=["0.6", *["tab:blue"] * (len(improvements) - 1)])
    errors = [2 * aim.scale * item.error for item in improvements]
    axes.errorbar(values, places, xerr=errors, fmt="none", ecolor="black", capsize=3)
    axes.axvline(values[0], color="0.3", linewidth=0.8, linestyle=":")
    axes.set_yticks(places, [item.label or item.name for item in improvements])
    axes.invert_yaxis()
    axes.set_xlabel(f"{aim.label} (bars: two standard errors of the gain)")
    return save_figure(figure, path)


def _create_figure(size: tuple[float, float], shape: tuple[int, int]) -> tuple[Figure, NDArray[Any]]:
    """Return a figure of a size in inches, and its axes in rows and columns as an array of this shape."""
    figure = Figure(figsize=size, dpi=120, facecolor="white", layout="constrained")
    return figure, figure.subplots(*shape, squeeze=False, sharey="row")


def _draw_map(figure: Figure, axes: Axes, depth_map: DepthMap, values: Floats, *, label: str, limit: float) -> None:
    """Draw values over diameter and depth in colours, and the line on which they equal a limit.

    A map whose limit is ``DETECTION_THRESHOLD`` is one of probability, any other one of the standard deviation of ln contrast.
    """
    axes.set_facecolor("0.88")
    probability = limit == DETECTION_THRESHOLD
    norm = Normalize(0.0, 1.0) if probability else LogNorm(MIN_SHOWN_SD, MAX_SHOWN_SD)
    colours = "viridis" if probability else "viridis_r"
    x, y = depth_map.diameter * MM_PER_M, depth_map.depth * MM_PER_M
    shown = axes.pcolormesh(x, y, values, cmap=colours, norm=norm, shading="nearest")
    ticks, ends = (PercentFormatter(1.0), "neither") if probability else ("%g", "both")
    figure.colorbar(shown, ax=axes, label=label, extend=ends, format=ticks)
    finite = values[np.isfinite(values)]
    if len(finite) and finite.min() < limit < finite.max():
        axes.contour(x, y, np.ma.masked_invalid(values), levels=[limit], colors="black", linewidths=1.8)
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        _format_axis(axis)
    # axes of a row share y: inverting it a second time would undo the first
    if axes.get_ylim()[0] < axes.get_ylim()[1]:
        axes.invert_yaxis()


def _format_axis(axis: Axis) -> None:
    """Label a logarithmic axis at 1, 2 and 5 times powers of ten, as plain numbers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _draw_tumours(axes: Axes, verified: PopulationVerification) -> None:
    """Draw the tumours of the verification as points, filled where detected more often than not."""
    performance = verified.performance
    detected = performance.values["detection"] >= 0.5
    x, y = performance.draw.diameter * MM_PER_M, performance.draw.depth * MM_PER_M
    # white in black: seen on every colour of the map
    axes.scatter(x, y, s=22, facecolors=np.where(detected, "white", "none"), edgecolors="black", linewidths=1.0)
