"""Plots of ratio and log-sensitivity over Young's modulus and over load; matplotlib is imported when one is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from geometry.common.arrays import Floats, Ints
from geometry.scenes.units import PA_PER_KPA
from solver.results.result import Curve, LoadCurve


def draw_curve(curve: Curve, scene_modulus: float | None = None, tissue_modulus: float | None = None) -> Figure:
    """Draw the ratio that readings are, with its error band, and its log-sensitivity over the inclusion's modulus.

    Returns the figure. The moduli of the scene's own inclusion and of its tissue, Pa, are marked if they are given and within the
    curve.
    """
    figure = Figure(figsize=(8.0, 7.0), dpi=150, facecolor="white", layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    modulus = np.array(curve.youngs_modulus) / PA_PER_KPA
    order = np.argsort(modulus)
    _plot_reading((top, bottom), curve, modulus, order, "." if len(modulus) < 25 else "")
    bottom.axhline(0.0, color="0.7", linewidth=0.8)
    bottom.set_xlabel("Young's modulus of the inclusion, kPa")
    for axes in (top, bottom):
        axes.set_xscale("log")
        axes.grid(alpha=0.3)
        for value, style, name in ((tissue_modulus, ":", "tissue"), (scene_modulus, "--", "the scene's inclusion")):
            if value is not None and modulus.min() <= value / PA_PER_KPA <= modulus.max():
                axes.axvline(value / PA_PER_KPA, color="0.4", linestyle=style, linewidth=1.0, label=name)
    top.legend(loc="best", fontsize=9)
    top.set_title(f"{curve.evaluator}: {len(modulus)} moduli in {curve.seconds:.2g} s", fontsize=10)
    return figure


def draw_load_curve(curve: LoadCurve) -> Figure:
    """Draw ratio, log-sensitivity and gap width over force, and mark where linear theory ends and where the gap closes."""
    figure = Figure(figsize=(8.0, 9.0), dpi=150, facecolor="white", layout="constrained")
    panels = figure.subplots(3, 1, sharex=True)
    force = np.array(curve.force)
    marker = "." if len(force) < 40 else ""
    _plot_reading(panels[:2], curve, force, np.arange(len(force)), marker)
    panels[2].plot(force, 1e6 * np.array(curve.closest_walls), color="tab:green", marker=marker)
    panels[2].set_ylabel("closest walls of the gap, \u00b5m")
    panels[2].set_ylim(bottom=0.0)
    panels[2].set_xlabel("force, N")
    for axes in panels:
        axes.grid(alpha=0.3)
        for load, style, name in (
            (curve.linear_limit_load, "--", "linear theory ends"),
            (curve.gap_closure_load, ":", "gap closes"),
        ):
            if load is not None and load.force <= 1.05 * force.max():
                axes.axvline(load.force, color="0.4", linestyle=style, linewidth=1.0, label=name)
    panels[0].legend(loc="best", fontsize=9)
    # from force to indentation and back: piecewise linear, and proportional above the last point
    forces, depths = (np.concatenate([[0.0], x, 1e6 * x[-1:]]) for x in (force, 1e3 * np.array(curve.indentation)))
    functions = partial(np.interp, xp=forces, fp=depths), partial(np.interp, xp=depths, fp=forces)
    depth = panels[0].secondary_xaxis("top", functions=functions)
    depth.set_xlabel("indentation, mm")
    panels[0].set_title(f"{curve.evaluator}: {len(force)} loads in {curve.seconds:.2g} s", fontsize=10)
    return figure


def _plot_reading(panels: Sequence[Axes], curve: Curve | LoadCurve, x: Floats, order: Ints, marker: str) -> None:
    """Plot ratio, with its error band, and log-sensitivity over x in this order; gaps where a value is None."""
    read = curve.reading
    ratio, error, sensitivity = (
        np.array(values, dtype=float)[order] for values in (read.ratio, read.error, read.log_sensitivity)
    )
    band = np.abs(ratio) * np.minimum(error, 1.0)
    panels[0].plot(x[order], ratio, color="tab:blue", marker=marker)
    panels[0].fill_between(x[order], ratio - band, ratio + band, color="tab:blue", alpha=0.2, label="bound on the error")
    panels[0].set_ylabel(f"ratio of inner to outer film {curve.observable}")
    panels[1].plot(x[order], sensitivity, color="tab:orange", marker=marker)
    panels[1].set_ylabel("log-sensitivity  d ln ratio / d ln E")
