"""Draw what `locate` has inferred: plan, section, marginals, and the fit of the readings."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator, PercentFormatter

from geometry.common.arrays import Floats
from geometry.scenes.units import MM_PER_M
from probe_design.locating.location import Location
from probe_design.locating.next_position import NextPosition
from probe_design.locating.posterior import (
    SUMMARY_NAMES,
    compute_plan,
    compute_section,
    draw_prior_values,
    find_places,
    list_values,
)

PLAN_POINTS, SECTION_POINTS = 97, 97  # of the maps, along each axis
DRAWN_SETS = 400  # equally probable sets of tumours behind a map, throughout all: neighbours lie at one place
PRIOR_COLOUR, POSTERIOR_COLOUR = "0.75", "tab:red"
FIGURE_DPI = 130  # of figures on the screen
QUANTITY_LABELS = {
    "x": ("x, mm", MM_PER_M), "y": ("y, mm", MM_PER_M), "depth": ("depth of the centre, mm", MM_PER_M),
    "diameter": ("diameter, mm", MM_PER_M), "youngs_modulus": ("Young's modulus, kPa", 1e-3), "ln_contrast": ("ln contrast", 1.0),
}  # fmt: skip
LEGENDS = {
    "plan.png": (
        "The tissue from above. Colour: the probability that some part of a tumour lies below this point, over all numbers of "
        "tumours; without any reading it would be the same faint colour everywhere. Each circle is a press of the probe. Its "
        "fill shows how far the reading lies from the prediction of the most probable tumours, in standard deviations: pale "
        "circles agree with it, dark blue and dark red ones do not."
    ),
    "section.png": (
        "The tissue from the side, cut through the median place of the clearest tumour; of several places, through the most "
        "probable. Colour: the probability that this point lies inside a tumour. The dashed circle has this place and the median "
        "depth and diameter: one guess among many."
    ),
    "marginals.png": (
        "What is known of the clearest tumour before the scan (grey) and after it (red). Where the two agree, the scan has "
        "taught nothing about this quantity. The bar below is the interval that holds it with a probability of 0.9."
    ),
    "fit.png": (
        "Each press in the order of the file: change of the reading against tumour-free tissue, as read (points with one "
        "standard deviation) and as the most probable tumours predict it (line). A square is the baseline reading."
    ),
}


LEGEND_ABOVE: dict[str, Any] = {  # the panel, as bars and readings may lie anywhere in it
    "fontsize": 7, "ncols": 2, "loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "frameon": False, "borderaxespad": 0.2
}  # fmt: skip


def draw_location(result: Location) -> Figure:
    """Draw plan, section and fit of a result in one figure, with a legend in words."""
    figure = Figure(figsize=(11, 8.6), dpi=FIGURE_DPI, facecolor="white", layout="constrained")
    axes = figure.subplot_mosaic([["plan", "section"], ["plan", "marginal"], ["fit", "fit"]], height_ratios=[1, 0.8, 1])
    _plot_plan(figure, axes["plan"], result)
    _plot_section(figure, axes["section"], result)
    _plot_marginal(axes["marginal"], result, "depth")
    _plot_fit(axes["fit"], result)
    figure.suptitle(
        f"no tumour {result.probability[0]:.2g}, "
        + ", ".join(f"{number}: {value:.2g}" for number, value in enumerate(result.probability) if number)
        + " (conditional on the population; no diagnosis)",
        fontsize=10,
    )
    return figure


def draw_plan(result: Location) -> Figure:
    """Draw the probability that a tumour lies below each point, with the presses."""
    figure = Figure(figsize=(7.2, 6.2), dpi=FIGURE_DPI, facecolor="white", layout="constrained")
    _plot_plan(figure, figure.subplots(), result)
    return figure


def draw_section(result: Location) -> Figure:
    """Draw the probability that each point of a section lies in a tumour."""
    figure = Figure(figsize=(7.2, 4.4), dpi=FIGURE_DPI, facecolor="white", layout="constrained")
    _plot_section(figure, figure.subplots(), result)
    return figure


def draw_marginals(result: Location) -> Figure:
    """Draw prior and posterior of each quantity of the clearest tumour."""
    figure = Figure(figsize=(9, 5), dpi=FIGURE_DPI, facecolor="white", layout="constrained")
    for axes, name in zip(figure.subplots(2, 3).ravel(), QUANTITY_LABELS, strict=True):
        _plot_marginal(axes, result, name)
    return figure


def draw_fit(result: Location) -> Figure:
    """Draw the readings and what the most probable tumours predict."""
    figure = Figure(figsize=(9, 3.6), dpi=FIGURE_DPI, facecolor="white", layout="constrained")
    _plot_fit(figure.subplots(), result)
    return figure


def plot_probability(axes: Axes, x: Floats, y: Floats, probability: Floats) -> QuadMesh:
    """Plot a probability, shape (len(y), len(x)), over coordinates in m; return what a colour bar needs."""
    return axes.pcolormesh(x * MM_PER_M, y * MM_PER_M, probability, cmap="YlOrRd", vmin=0, vmax=1, shading="nearest")


def plot_next(axes: Axes, position: NextPosition, size: float) -> tuple[float, float]:
    """Plot a star where to press next, ``size`` in printer's points; return its coordinates, mm."""
    place = position.x * MM_PER_M, position.y * MM_PER_M
    axes.plot(*place, marker="*", color="tab:blue", markersize=size, markeredgecolor="white", linestyle="none")
    return place


def _get_window(result: Location) -> tuple[Floats, Floats]:
    """Return the coordinates of the maps' columns and rows, m: where tumours may lie, and all presses near it."""
    windows = []
    for axis in range(2):
        values = result.tumour_prior.ranges[axis].values
        presses = result.data.positions[~result.data.is_baseline, axis]
        margin = result.scene.probe.tube_radius / 2
        windows.append(np.linspace(min(*values, *presses) - margin, max(*values, *presses) + margin, PLAN_POINTS))
    return windows[0], windows[1]


def _mix(result: Location, compute: object, *arguments: object) -> Floats:
    """Return a map over all numbers of tumours, weighted by their probability."""
    total: Floats = np.zeros(1)
    for part, probability in zip(result.by_number, result.probability[1:], strict=True):
        total = total + probability * compute(part.sets[:: max(1, len(part.sets) // DRAWN_SETS)], *arguments)  # type: ignore[operator]
    return total


def _plot_plan(figure: Figure, axes: Axes, result: Location) -> None:
    """Plot the plan."""
    x, y = _get_window(result)
    probability = _mix(result, compute_plan, x, y)
    picture = plot_probability(axes, x, y, probability)
    figure.colorbar(picture, ax=axes, label="probability that a tumour lies below", shrink=0.8, format=PercentFormatter(1.0))
    deviations = [float(part.ratio or part.stiffness or 0.0) for part in result.residuals]
    inside = [index for index, part in enumerate(result.residuals) if not part.blank]
    presses = axes.scatter(
        [result.residuals[index].x * MM_PER_M for index in inside], [result.residuals[index].y * MM_PER_M for index in inside],
        c=[deviations[index] for index in inside], cmap="coolwarm", vmin=-4, vmax=4, s=46, edgecolors="0.25", linewidths=0.8,
    )  # fmt: skip
    figure.colorbar(presses, ax=axes, label="residual of the press, standard deviations", shrink=0.8)
    if result.next is not None:
        place = plot_next(axes, result.next, 16)
        axes.annotate("press here next", place, xytext=(8, 8), textcoords="offset points", fontsize=8, color="tab:blue")
    axes.set(xlabel="x, mm", ylabel="y, mm", title="from above: where a tumour lies", aspect="equal")


def _plot_section(figure: Figure, axes: Axes, result: Location) -> None:
    """Plot the section through the clearest tumour."""
    quantities = result.tumours[0].quantities
    x, _ = _get_window(result)
    deepest = max(result.tumour_prior.ranges[2].values) + max(result.tumour_prior.ranges[3].values) / 2
    (centre_x, y), *_ = find_places(*result.best.sets[:, 0, :2].T)
    depth = np.linspace(0, deepest, SECTION_POINTS)
    probability = _mix(result, compute_section, x, depth, y)
    picture = plot_probability(axes, x, depth, probability)
    figure.colorbar(picture, ax=axes, label="probability of tumour", shrink=0.8, format=PercentFormatter(1.0))
    if result.probability[0] < 0.5:
        centre = (centre_x * MM_PER_M, quantities["depth"].median * MM_PER_M)
        radius = quantities["diameter"].median * MM_PER_M / 2
        axes.add_patch(Circle(centre, radius, facecolor="none", edgecolor="0.2", linestyle="--"))
    axes.set(
        xlabel="x, mm", ylabel="depth, mm", title=f"from the side, at y = {y * MM_PER_M:.1f} mm", aspect="equal",
        ylim=(deepest * MM_PER_M, 0),
    )  # fmt: skip


def _plot_marginal(axes: Axes, result: Location, name: str) -> None:
    """Plot prior and posterior of one quantity of the clearest tumour."""
    label, scale = QUANTITY_LABELS[name]
    prior, column = result.tumour_prior, SUMMARY_NAMES.index(name)
    before = scale * draw_prior_values(prior, result.best.log_tissue_sd)[:, column]
    after = scale * list_values(prior, result.best.sets, result.best.log_tissue)[:, 0, column]
    edges = np.linspace(min(before.min(), after.min()), max(before.max(), after.max()), 31).tolist()
    if edges[-1] - edges[0] > 1e-9 * abs(edges[0]):
        axes.hist(before, edges, density=True, color=PRIOR_COLOUR, label="before the scan")
        axes.hist(after, edges, density=True, histtype="step", color=POSTERIOR_COLOUR, linewidth=1.6, label="after it")
        axes.legend(**LEGEND_ABOVE)
    else:
        axes.text(0.5, 0.5, "given by\nthe design file", ha="center", va="center", transform=axes.transAxes)
    low, high = (scale * end for end in result.tumours[0].quantities[name].interval_90)
    axes.plot([low, high], [0, 0], color=POSTERIOR_COLOUR, linewidth=4, solid_capstyle="butt", clip_on=False)
    axes.set(xlabel=label, yticks=[])


def _plot_fit(axes: Axes, result: Location) -> None:
    """Plot the readings and their prediction."""
    order = np.arange(len(result.residuals))
    is_baseline = result.data.is_baseline
    for channel, (name, colour) in enumerate((("ratio", "tab:blue"), ("stiffness", "tab:green"))):
        read = result.data.is_read[:, channel]
        if not read.any():
            continue
        changes = np.array([getattr(part, f"{name}_change") for part in result.residuals], dtype=float) * 100
        predicted = np.array([getattr(part, f"predicted_{name}_change") for part in result.residuals], dtype=float) * 100
        sd = np.where(read, np.sqrt(result.data.variance[:, channel]), 0) * 100
        axes.plot(order, predicted, color=colour, linewidth=1.2, label=f"{name}, predicted")
        for mask, marker in ((~is_baseline & read, "o"), (is_baseline & read, "s")):
            label = None if marker == "s" else f"{name}, read"
            axes.errorbar(
                order[mask], changes[mask], sd[mask], fmt=marker, color=colour, markersize=4, linewidth=0.8, label=label
            )
    axes.axhline(0, color="0.7", linewidth=0.8)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel="press, in the order of the file", ylabel="change against\ntumour-free tissue, %")
    axes.legend(**LEGEND_ABOVE | {"ncols": 4})
