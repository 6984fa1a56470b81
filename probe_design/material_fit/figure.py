"""Draw a measured curve and the laws fitted to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from probe_design.material_fit.material_fit import NAMES, MaterialFit

CURVE_POINTS = 200  # of each law's line


def draw_fit(fit: MaterialFit) -> Figure:
    """Return a figure of the measured nominal stress and of each fitted law over the deformation."""
    figure = Figure(figsize=(8.0, 5.0), dpi=150, facecolor="white", layout="constrained")
    axes = figure.subplots()
    s = np.linspace(fit.curve.deformation.min(), fit.curve.deformation.max(), CURVE_POINTS)
    line = replace(fit.curve, deformation=s, stress=np.zeros_like(s))
    axes.plot(fit.curve.deformation, 1e-3 * fit.curve.stress, ".", color="0.4", label="measured")
    for law, color in zip(fit.laws, ("tab:blue", "tab:green", "tab:orange"), strict=True):
        width = 2.0 if law is fit.chosen else 0.8
        axes.plot(s, 1e-3 * law.predict(line), color=color, linewidth=width, label=NAMES[law.count])
    axes.set_xlabel("shear" if fit.curve.test == "shear" else "stretch")
    axes.set_ylabel("nominal stress, kPa")
    axes.set_title(f"{fit.source}: {fit.describe_misfit()}", fontsize=10)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=9)
    return figure
