"""The pictures of a report: start beside optimum over depth and diameter, Pareto fronts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from probe_design.data.noise import RESOLVED
from probe_design.design_report.depth_map import SURE, DepthMap
from probe_design.pictures.formats import save

if TYPE_CHECKING:
    from probe_design.design_search.judging import JudgedDesign
    from probe_design.design_search.pareto import Front

MM = 1e3
BLUE, GREY = "#2a6f97", "#9aa5b1"
LEAST_SD, MOST_SD = 0.05, 5.0  # of ln contrast: what the colours tell apart


def draw_maps(maps: dict[str, DepthMap], judged: dict[str, JudgedDesign], path: Path) -> Path:
    """Draw P and the standard deviation of ln contrast over diameter and depth, a column for each design; returns ``path``.

    Judged tumours are points: filled where they are found more often than not.
    """
    figure, axes = _figure((5.4 * len(maps), 9.0), (2, len(maps)))
    for column, (name, one) in enumerate(maps.items()):
        for row, (values, label, limit) in enumerate(
            ((one.probability, "probability of detection", SURE), (one.contrast_sd, "sd of ln contrast", RESOLVED))
        ):
            _map(figure, axes[row][column], one, values, label=label, limit=limit)
        axes[0][column].set_title(name, fontsize=11)
        _tumours(axes[0][column], judged[name])
    for row in axes:
        row[0].set_ylabel("depth of the centre, mm")
    for one in axes[-1]:
        one.set_xlabel("diameter, mm")
    figure.suptitle(
        "by the closed form, a known tumour in the middle of the population's ranges (an upper bound); points: those verified,\n"
        "full where detected more often than not; lines: 90 % detected, contrast resolved to 0.5",
        fontsize=9,
    )
    return save(figure, path)


def draw_front(fronts: tuple[Front, ...], name: str, path: Path) -> Path:
    """Draw Pareto fronts side by side; returns ``path``."""
    figure, axes = _figure((5.0 * len(fronts), 4.0), (1, len(fronts)))
    for plain, front in zip(axes[0], fronts, strict=True):
        plain.plot(front.shown, [one.value for one in front.points], "-", color=GREY, label="by the closed form")
        judged = [(at, one) for at, one in zip(front.shown, front.points, strict=True) if one.judged is not None]
        if judged:
            values, errors = zip(*(one.judged for _, one in judged), strict=True)
            plain.errorbar([at for at, _ in judged], values, errors, fmt="o", color=BLUE, capsize=3, label="judged, one error")
        plain.set_xlabel(front.label)
        plain.set_ylabel(name)
        plain.legend(fontsize=8)
    return save(figure, path)


def _figure(size: tuple[float, float], shape: tuple[int, int]) -> tuple[Any, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, dpi=120, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(*shape, squeeze=False, sharey="row")


def _map(figure: Any, axes: Any, one: DepthMap, values: Any, *, label: str, limit: float) -> None:
    axes.set_facecolor("0.88")
    from matplotlib.colors import LogNorm, Normalize

    probability = limit == SURE
    norm = Normalize(0.0, 1.0) if probability else LogNorm(LEAST_SD, MOST_SD)
    colours = "viridis" if probability else "viridis_r"
    x, y = one.diameter * MM, one.depth * MM
    shown = axes.pcolormesh(x, y, values, cmap=colours, norm=norm, shading="nearest")
    figure.colorbar(shown, ax=axes, label=label, extend="neither" if probability else "both", format="%g")
    finite = values[np.isfinite(values)]
    if len(finite) and finite.min() < limit < finite.max():
        axes.contour(x, y, np.ma.masked_invalid(values), levels=[limit], colors="white", linewidths=1.6)
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        _plain_numbers(axis)
    if axes.get_ylim()[0] < axes.get_ylim()[1]:
        axes.invert_yaxis()


def _plain_numbers(axis: Any) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _tumours(axes: Any, judged: JudgedDesign) -> None:
    found = judged.judgement.probability >= 0.5
    x, y = judged.judgement.diameter * MM, judged.judgement.depth * MM
    axes.scatter(x, y, s=16, facecolors=np.where(found, "white", "none"), edgecolors="white", linewidths=0.8)
