"""Draw stated and true errors against time for each scene, with the Pareto front."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from geometry.common.errors import escape_unprintable
from geometry.common.percent import format_percent
from probe_design.reporting.picture_files import save_figure
from probe_design.tradeoffs.rows import Row, find_pareto_front, remove_duplicates
from probe_design.tradeoffs.study import Tradeoff

EVALUATOR_COLOURS = {
    "closed-form": "tab:green", "equivalent-inclusion": "tab:orange", "axisymmetric": "tab:blue", "solid": "tab:purple",
    "contact": "tab:red",
}  # fmt: skip
EVALUATOR_MARKERS = {"closed-form": "D", "equivalent-inclusion": "s", "axisymmetric": "o", "solid": "^", "contact": "P"}
FRONT_STYLE: dict[str, Any] = {"color": "0.55", "linewidth": 5.0, "alpha": 0.35}
MIN_DRAWN_ERROR = 1e-8  # smaller errors are drawn here
MAX_PANELS = 30  # scenes drawn; the title says if there are more


def plot_tradeoff(study: Tradeoff, path: Path) -> Path:
    """Draw a panel for each of the first ``MAX_PANELS`` scenes to a .png file; return ``path``.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    names = list(study.scenes)[:MAX_PANELS]
    column_count = min(3, len(names))
    row_count = -(-len(names) // column_count)  # rounded up
    size = (max(7.5, 4.2 * column_count), 3.5 * row_count + 1.6)
    figure = Figure(figsize=size, dpi=130, facecolor="white", layout="constrained")
    grid = figure.subplots(row_count, column_count, sharex=True, sharey=True, squeeze=False)
    for axes, name in zip(grid.flat, names, strict=False):
        _draw_panel(axes, name, study.find_rows(name))
    for axes in grid.flat[len(names) :]:
        axes.set_axis_off()
    figure.supxlabel("time of one evaluation, s", fontsize=10)
    figure.supylabel("relative error of the ratio", fontsize=10)
    remark = "" if len(names) == len(study.scenes) else f" (the first {len(names)} of {len(study.scenes)} scenes)"
    figure.suptitle(f"Speed against accuracy{remark}", fontsize=13)
    _draw_legend(figure, study)
    return save_figure(figure, path)


def _draw_panel(axes: Axes, name: str, rows: Sequence[Row]) -> None:
    """Draw the panel of one scene: errors of its ``rows`` against time, the Pareto front, and evaluators without a result."""
    results = remove_duplicates(rows)
    _draw_front(axes, results)
    for row in results:
        _draw_row(axes, row)
    _label_accuracies(axes, results)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(alpha=0.25)
    axes.tick_params(labelbottom=True)  # the panel below may be empty
    axes.set_title(escape_unprintable(name), fontsize=10, parse_math=False)
    refusing = sorted({row.evaluator for row in rows} - {row.evaluator for row in results})
    if refusing:
        text = f"no result: {', '.join(refusing)}"
        axes.text(0.98, 0.97, text, transform=axes.transAxes, ha="right", va="top", fontsize=7.5, color="0.35")


def _draw_front(axes: Any, results: Sequence[Row]) -> None:
    """Draw the Pareto front as steps: the smallest stated error that is available within a time."""
    front = find_pareto_front(results)
    if not front:
        return
    x = [row.seconds_probe for row in front]
    y = [_clip_error(row.stated_error) for row in front]
    # the last step goes on to three times its time, so that it is visible
    axes.step([*x, 3 * (x[-1] or 0.0)], [*y, y[-1]], where="post", zorder=1, **FRONT_STYLE)


def _draw_row(axes: Any, row: Row) -> None:
    """Draw the marks of one row: stated error, true error or its upper limit, and the time of the next tumour."""
    colour, marker = EVALUATOR_COLOURS[row.evaluator], EVALUATOR_MARKERS[row.evaluator]
    x, stated_error = row.seconds_probe, _clip_error(row.stated_error)
    true = None if row.true_error is None else _clip_error(row.true_error if row.is_resolved else row.true_error_most)
    if true is not None:
        axes.plot([x, x], [stated_error, true], color=colour, linewidth=0.8, alpha=0.6, zorder=2)
        shape = marker if row.is_resolved else "v"
        axes.plot(x, true, shape, markerfacecolor="white", markeredgecolor=colour, markersize=5.5, zorder=3)
    if row.seconds_tumour is not None and x is not None and row.seconds_tumour < x / 2:
        axes.plot([row.seconds_tumour, x], [stated_error, stated_error], ":", color=colour, linewidth=1.0, zorder=2)
        axes.plot(row.seconds_tumour, stated_error, "|", color=colour, markersize=8, zorder=3)
    axes.plot(x, stated_error, "*" if row.reference else marker, color=colour, markersize=12 if row.reference else 6.5, zorder=4)


def _label_accuracies(axes: Axes, results: Sequence[Row]) -> None:
    """Label points with the requested accuracy, where labels do not overlap."""
    label_places: list[tuple[float, float]] = []  # log10 of time and error of the labels so far
    white = {"facecolor": "white", "edgecolor": "none", "alpha": 0.6, "pad": 0.3}
    for row in results:
        x, y = math.log10(row.seconds_probe or 1.0), math.log10(_clip_error(row.stated_error))
        if row.accuracy is None or any(abs(x - label_x) < 0.6 and abs(y - height) < 0.35 for label_x, height in label_places):
            continue
        label_places.append((x, y))
        axes.annotate(
            format_percent(row.accuracy, 6), (10**x, 10**y), xytext=(6, 4), textcoords="offset points", fontsize=7.5,
            color=EVALUATOR_COLOURS[row.evaluator], zorder=5, bbox=white,
        )  # fmt: skip


def _clip_error(error: float | None) -> float:
    """Return an error as it is drawn: not below ``MIN_DRAWN_ERROR``, NaN where it is unknown."""
    return math.nan if error is None else max(error, MIN_DRAWN_ERROR)


def _draw_legend(figure: Any, study: Tradeoff) -> None:
    """Draw the legend below the panels."""
    shown_evaluators = dict.fromkeys(row.evaluator for row in study.rows if row.ratio is not None)
    styles: dict[str, dict[str, Any]] = {
        name if name == "closed-form" else f"{name}: requested accuracy": {
            "marker": EVALUATOR_MARKERS[name],
            "color": EVALUATOR_COLOURS[name],
        }
        for name in shown_evaluators
    }
    styles |= {
        "stated error": {"marker": "o"},
        "true error": {"marker": "o", "markerfacecolor": "white"},
        "true error is below this": {"marker": "v", "markerfacecolor": "white"},
        "reference": {"marker": "*", "markersize": 11},
        "Pareto front of stated errors": FRONT_STYLE | {"linestyle": "-"},
        "next tumour, same probe": {"marker": "|", "linestyle": ":", "markersize": 8},
    }
    handles = [Line2D([], [], label=label, **({"color": "0.3", "linestyle": ""} | style)) for label, style in styles.items()]
    columns = 3 if len(study.scenes) > 1 else 2
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, fontsize=8.5, frameon=False)
