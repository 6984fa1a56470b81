"""Draw an uncertainty budget: contribution of each number to the ratio, and its share of the variance."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from probe_design.tolerancing.budget import ToleranceBudget


def draw_budget(budget: ToleranceBudget) -> Figure:
    """Draw a budget: on the left the contribution of each number to ln ratio, on the right its share of the variance."""
    lines = budget.lines[::-1]  # the largest contribution on top
    rows, parts = np.arange(len(lines)), [line.outputs["ln_ratio"] for line in lines]
    figure = Figure(figsize=(10.0, 1.5 + 0.4 * len(lines)), dpi=150, facecolor="white", layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    left.barh(rows, [100 * part.contribution for part in parts], color="tab:blue")
    left.set_yticks(rows, [line.name for line in lines])
    left.set_xlabel("change of the ratio by one standard deviation, %")
    right.plot([part.share for part in parts], rows, "s", color="tab:blue", label="share, first order")
    with_indices = [
        (row, part) for row, part in zip(rows, parts, strict=True) if part.total is not None and part.total_interval is not None
    ]
    if with_indices:
        total = np.array([part.total for _, part in with_indices])
        ends = np.array([part.total_interval for _, part in with_indices]).T
        error = np.maximum([total - ends[0], ends[1] - total], 0.0)
        positions = np.array([row for row, _ in with_indices]) - 0.2
        right.errorbar(total, positions, xerr=error, fmt="o", color="tab:orange", capsize=3, label="Sobol total, 95 %")
    right.set_xlabel("share of the variance of ln ratio")
    right.legend(loc="lower right", fontsize=9)
    for axes in (left, right):
        axes.grid(alpha=0.3, axis="x")
    figure.suptitle(f"{budget.evaluator}: ln ratio scatters by {budget.outputs['ln_ratio'].sd:.3g}", fontsize=10)
    return figure
