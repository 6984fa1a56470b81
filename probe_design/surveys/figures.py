"""Draw a survey: the map after each press, and all of them side by side."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import PercentFormatter

from geometry.common.arrays import Floats
from geometry.scenes.units import MM_PER_M
from probe_design.locating.figures import plot_next, plot_probability
from probe_design.locating.locator import Locator
from probe_design.locating.next_position import NextPosition
from probe_design.locating.posterior import compute_plan

PLAN_POINTS, PLAN_SETS = 81, 300  # of a map along each axis; sets of tumours behind it
MAX_PANELS, PANEL_COLUMNS = 12, 4  # of the sequence
LEGEND = (
    "The tissue from above after each press. Colour: the probability that some part of a tumour lies below this point. Numbers: "
    "the presses as in the table, the last one bold. Star: where to press next, as that reading is expected to say the most. "
    "Dashed circles, if any: the tumours that the virtual tissue hides."
)


@dataclass(frozen=True)
class Step:
    """What is known after a press.

    Attributes
    ----------
    number
        Presses so far, the baseline reading included.
    x, y
        Coordinates of the map, m.
    plan
        Probability that a tumour lies below each point, shape (len(y), len(x)).
    positions
        Presses over the tissue, m, shape (k, 2).
    press_numbers
        Of these in their order, the baseline reading counted, k whole numbers.
    probability_none
        Probability of no tumour.
    following
        Where to press next; None at the end.
    """

    number: int
    x: Floats
    y: Floats
    plan: Floats
    positions: Floats
    press_numbers: tuple[int, ...]
    probability_none: float
    following: NextPosition | None

    @classmethod
    def from_locator(cls, locator: Locator, following: NextPosition | None) -> Step:
        """Return the step of the readings so far."""
        margin = locator.design.scene.probe.tube_radius / 2
        x, y = (
            np.linspace(min(part.values) - margin, max(part.values) + margin, PLAN_POINTS) for part in locator.prior.ranges[:2]
        )
        sets = zip(locator.draw_sets(PLAN_SETS), locator.probability[1:], strict=True)
        plan = sum((share * compute_plan(tumours, x, y) for tumours, share in sets), np.zeros((PLAN_POINTS, PLAN_POINTS)))
        presses = {number: part for number, part in enumerate(locator.readings, start=1) if not part.blank}
        positions = np.array([(part.x, part.y) for part in presses.values()]).reshape(-1, 2)
        return cls(len(locator.readings), x, y, plan, positions, tuple(presses), locator.probability_none, following)


def draw_step(step: Step, hidden: Floats | None = None) -> Figure:
    """Draw the map after one press; ``hidden`` tumours, shape (m, 5), are shown as circles."""
    figure = Figure(figsize=(6.4, 5.6), dpi=110, facecolor="white", layout="constrained")
    axes = figure.subplots()
    picture = _plot_step(axes, step, hidden, size=9)
    figure.colorbar(picture, ax=axes, label="probability that a tumour lies below", shrink=0.85, format=PercentFormatter(1.0))
    return figure


def draw_sequence(steps: list[Step], hidden: Floats | None = None) -> Figure:
    """Draw the maps of a survey from the first press to the last, at most ``MAX_PANELS`` of them."""
    chosen = sorted({round(index) for index in np.linspace(0, len(steps) - 1, min(len(steps), MAX_PANELS)).tolist()})
    columns = min(PANEL_COLUMNS, len(chosen))
    rows = math.ceil(len(chosen) / columns)
    figure = Figure(figsize=(3.1 * columns + 0.9, 3.3 * rows + 0.5), dpi=110, facecolor="white", layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes in grid.ravel()[len(chosen) :]:
        axes.set_axis_off()
    for axes, index in zip(grid.ravel(), chosen, strict=False):
        picture = _plot_step(axes, steps[index], hidden, size=7)
        axes.label_outer()
    figure.colorbar(picture, ax=grid, label="probability that a tumour lies below", shrink=0.7, format=PercentFormatter(1.0))
    return figure


def _plot_step(axes: Axes, step: Step, hidden: Floats | None, *, size: int) -> QuadMesh:
    """Plot one map; return what a colour bar needs."""
    picture = plot_probability(axes, step.x, step.y, step.plan)
    for number, (x, y) in zip(step.press_numbers, step.positions * MM_PER_M, strict=True):
        is_last = number == step.number
        axes.text(
            x, y, str(number), fontsize=size, ha="center", va="center", color="black" if is_last else "0.3",
            fontweight="bold" if is_last else "normal",
        )  # fmt: skip
    for x, y, _, diameter, _ in [] if hidden is None else hidden * MM_PER_M:
        axes.add_patch(Circle((x, y), diameter / 2, facecolor="none", edgecolor="tab:blue", linestyle="--"))
    if step.following is not None:
        plot_next(axes, step.following, 1.7 * size)
    none = f"{step.probability_none:.2f}" if step.probability_none >= 0.01 else f"{step.probability_none:.0e}"
    what = f"no tumour {none}" if len(step.positions) else "baseline"
    axes.set_title(f"press {step.number}: {what}", fontsize=size + 1)
    axes.set(xlabel="x, mm", ylabel="y, mm", aspect="equal")
    return picture
