"""Draw stated and true errors against time for each scene, with the Pareto front."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from geometry.common.errors import printable
from probe_design.pictures.formats import save
from probe_design.tradeoffs.rows import Row, distinct, pareto
from probe_design.tradeoffs.study import Tradeoff

COLOURS = {
    "closed-form": "tab:green", "equivalent-inclusion": "tab:orange", "axisymmetric": "tab:blue", "solid": "tab:purple",
}  # fmt: skip
MARKERS = {"closed-form": "D", "equivalent-inclusion": "s", "axisymmetric": "o", "solid": "^"}
FLOOR = 1e-8  # smaller errors are drawn here
MOST_PANELS = 30  # scenes drawn; the title says if there are more


def plot(study: Tradeoff, path: Path) -> Path:
    """Draw a panel for each of the first 30 scenes to a .png file; returns ``path``.

    Raises:
        OSError: the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = list(study.scenes)[:MOST_PANELS]
    across = min(3, len(names))
    down = -(-len(names) // across)
    size = (max(7.5, 4.2 * across), 3.5 * down + 1.6)
    figure = Figure(figsize=size, dpi=130, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False)
    for axes, name in zip(grid.flat, names, strict=False):
        _panel(axes, name, study.of(name))
    for axes in grid.flat[len(names) :]:
        axes.set_axis_off()
    for column in range(across):
        _bottom(grid, len(names), column).set_xlabel("time of one evaluation, s")
    for axes in grid[:, 0]:
        axes.set_ylabel("relative error of the ratio")
    left = "" if len(names) == len(study.scenes) else f" (the first {len(names)} of {len(study.scenes)} scenes)"
    figure.suptitle(f"Speed against accuracy{left}", fontsize=13)
    _legend(figure, study)
    return save(figure, path)


def _bottom(grid: Any, count: int, column: int) -> Any:
    """Return the lowest used panel of a column, with its x labels on: the panels below it may be empty."""
    across = grid.shape[1]
    row = (count - 1 - column) // across
    axes = grid[row, column]
    axes.tick_params(labelbottom=True)
    return axes


def _panel(axes: Any, name: str, rows: Sequence[Row]) -> None:
    """Draw the panel of one scene."""
    answers = distinct(rows)
    _front(axes, answers)
    for row in answers:
        _answer(axes, row)
    _labels(axes, answers)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(alpha=0.25)
    axes.set_title(printable(name), fontsize=10, parse_math=False)
    silent = {row.evaluator for row in rows} - {row.evaluator for row in answers}
    if silent:
        axes.text(
            0.98, 0.97, f"no result: {', '.join(sorted(silent))}", transform=axes.transAxes, ha="right", va="top", fontsize=7.5,
            color="0.35",
        )  # fmt: skip


def _front(axes: Any, answers: Sequence[Row]) -> None:
    """Draw the Pareto front as steps: the smallest stated error that is available within a time."""
    front = pareto(answers)
    if not front:
        return
    x = [row.seconds_probe for row in front]
    y = [_shown(row.stated_error) for row in front]
    axes.step([*x, 3 * (x[-1] or 0.0)], [*y, y[-1]], where="post", color="0.55", linewidth=5.0, alpha=0.35, zorder=1)


def _answer(axes: Any, row: Row) -> None:
    """Draw one row: stated error, true error or its upper limit, and the time of the next tumour."""
    colour, marker = COLOURS[row.evaluator], MARKERS[row.evaluator]
    x, stated = row.seconds_probe, _shown(row.stated_error)
    true = None if row.true_error is None else _shown(row.true_error if row.resolved else row.true_error_most)
    if true is not None:
        axes.plot([x, x], [stated, true], color=colour, linewidth=0.8, alpha=0.6, zorder=2)
        shape = marker if row.resolved else "v"
        axes.plot(x, true, shape, markerfacecolor="white", markeredgecolor=colour, markersize=5.5, zorder=3)
    if row.seconds_tumour is not None and x is not None and row.seconds_tumour < x / 2:
        axes.plot([row.seconds_tumour, x], [stated, stated], ":", color=colour, linewidth=1.0, zorder=2)
        axes.plot(row.seconds_tumour, stated, "|", color=colour, markersize=8, zorder=3)
    axes.plot(x, stated, "*" if row.reference else marker, color=colour, markersize=12 if row.reference else 6.5, zorder=4)


def _labels(axes: Any, answers: Sequence[Row]) -> None:
    """Label points with the requested accuracy, where labels do not overlap."""
    taken: list[tuple[float, float]] = []
    white = {"facecolor": "white", "edgecolor": "none", "alpha": 0.6, "pad": 0.3}
    for row in answers:
        x, y = math.log10(row.seconds_probe or 1.0), math.log10(_shown(row.stated_error))
        if row.accuracy is None or any(abs(x - other) < 0.6 and abs(y - height) < 0.35 for other, height in taken):
            continue
        taken.append((x, y))
        axes.annotate(
            f"{row.accuracy:g}", (10**x, 10**y), xytext=(6, 4), textcoords="offset points", fontsize=7.5,
            color=COLOURS[row.evaluator], zorder=5, bbox=white,
        )  # fmt: skip


def _shown(error: float | None) -> float:
    return math.nan if error is None else max(error, FLOOR)


def _legend(figure: Any, study: Tradeoff) -> None:
    """Draw the legend below the panels."""
    from matplotlib.lines import Line2D

    def line(label: str, marker: str = "", colour: str = "0.3", style: str = "", **more: Any) -> Line2D:
        return Line2D([], [], marker=marker, color=colour, linestyle=style, label=label, **more)

    levels = dict.fromkeys(row.evaluator for row in study.rows if row.ratio is not None)
    handles = [
        line(level if level == "closed-form" else f"{level}: requested accuracy", MARKERS[level], COLOURS[level])
        for level in levels
    ]
    handles += [
        line("stated error", "o"),
        line("true error", "o", markerfacecolor="white"),
        line("true error is below this", "v", markerfacecolor="white"),
        line("reference", "*", markersize=11),
        line("Pareto front of stated errors", colour="0.55", style="-", linewidth=5.0, alpha=0.35),
        line("next tumour, same probe", "|", style=":", markersize=8),
    ]
    figure.legend(
        handles=handles, loc="outside lower center", ncols=3 if len(study.scenes) > 1 else 2, fontsize=8.5, frameon=False
    )
