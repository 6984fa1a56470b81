"""Pictures of judgements: which tumours are found and told, and what would help most."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from geometry.common.arrays import Floats
from probe_design.data.noise import MAX_RESOLVED_LOG_SD
from probe_design.design_report.levers import Lever
from probe_design.populations.judgement import Judgement
from probe_design.reporting.picture_files import check_format, save_figure

MIN_SHOWN_SD, MAX_SHOWN_SD = 0.05, 5.0  # of ln contrast: what the colours tell apart
MARK_SIZE_POINTS2 = 60.0  # of marks, points^2


def plot_judgements(judgements: Sequence[tuple[str, Judgement]], path: Path) -> Path:
    """Draw P and the standard deviation of ln contrast of each tumour over depth and diameter, one column for each judgement.

    Args:
        judgements: one or more with their names, such as start and optimum, which share the colours.
        path: of the picture, in one of ``probe_design.reporting.picture_files.PICTURE_SUFFIXES``.

    Raises:
        InputError: the format is not known.
    """
    check_format(path)
    figure = Figure(figsize=(1.2 + 4.0 * len(judgements), 7.0), layout="constrained")
    axes = figure.subplots(2, len(judgements), squeeze=False, sharex=True, sharey=True)
    scales: tuple[Any, Any] = (Normalize(0.0, 1.0), LogNorm(MIN_SHOWN_SD, MAX_SHOWN_SD))
    marks: list[Any] = [None, None]
    for column, (name, judgement) in enumerate(judgements):
        deviations = np.clip(judgement.contrast_sd, MIN_SHOWN_SD, MAX_SHOWN_SD)
        for row, (values, colours) in enumerate(((judgement.probability, "viridis"), (deviations, "viridis_r"))):
            marks[row] = _draw_tumours(axes[row, column], judgement, values, scales[row], colours)
        caption = f"{judgement.detection:.2f} ± {judgement.detection_error:.2f} detected, {judgement.resolved:.2f} resolved"
        axes[0, column].set_title(f"{name}\n{caption}", fontsize=10)
        axes[1, column].set_xlabel("diameter, mm")
    for row, label in enumerate(("probability of detection", "sd of ln contrast")):
        axes[row, 0].set_ylabel("depth of the centre, mm")
        figure.colorbar(marks[row], ax=axes[row, :].tolist(), label=label, extend="both" if row else "neither")
    axes[0, 0].invert_yaxis()
    figure.supxlabel(f"circled: ln contrast resolved to {MAX_RESOLVED_LOG_SD:g}", fontsize=9)
    return save_figure(figure, path)


def _draw_tumours(axes: Any, judgement: Judgement, values: Floats, scale: Any, colours: str) -> Any:
    """One mark for each tumour, with a ring round those that are told."""
    resolved = judgement.contrast_sd <= MAX_RESOLVED_LOG_SD
    mm = 1e3 * judgement.diameter, 1e3 * judgement.depth
    axes.scatter(
        mm[0][resolved], mm[1][resolved], s=2.2 * MARK_SIZE_POINTS2, facecolors="none", edgecolors="black", linewidths=1.2
    )
    return axes.scatter(*mm, c=values, s=MARK_SIZE_POINTS2, norm=scale, cmap=colours, edgecolors="0.4", linewidths=0.4)


def plot_levers(levers: Sequence[Lever], label: str, path: Path) -> Path:
    """Draw what each lever brings as bars, with two standard errors.

    Args:
        levers: see ``levers``, the first being none at all.
        label: of the objective.
        path: of the picture.

    Raises:
        InputError: the format is not known.
    """
    check_format(path)
    figure = Figure(figsize=(6.5, 1.2 + 0.42 * len(levers)), layout="constrained")
    axes = figure.subplots()
    names, places = [lever.name for lever in levers], np.arange(len(levers))
    axes.barh(places, [lever.value for lever in levers], color=["0.6", *["tab:blue"] * (len(levers) - 1)])
    axes.errorbar(
        [lever.value for lever in levers],
        places,
        xerr=[2 * lever.error for lever in levers],
        fmt="none",
        ecolor="black",
        capsize=3,
    )
    axes.axvline(levers[0].value, color="0.3", linewidth=0.8, linestyle=":")
    axes.set_yticks(places, names)
    axes.invert_yaxis()
    axes.set_xlabel(f"{label} (bars: two standard errors of the gain)")
    return save_figure(figure, path)
