"""The picture of a curve: ratio and log-sensitivity against Young's modulus, with the band of the error."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from probe_design.pictures.formats import check_format, save
from solver.results.result import Curve


def plot(curve: Curve, path: Path, scene_modulus: float | None = None, tissue_modulus: float | None = None) -> Path:
    """Draw a curve to a file; moduli of the scene's own inclusion and tissue are marked. Returns ``path``.

    Raises:
        InputError: see ``check_format``.
        OSError: the file cannot be written.
    """
    check_format(path)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 7.0), dpi=150, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    top, bottom = figure.subplots(2, 1, sharex=True)
    modulus = np.array(curve.youngs_modulus)
    order = np.argsort(modulus)
    ratio, error, sensitivity = (_numbers(values)[order] for values in (curve.ratio, curve.error_estimate, curve.log_sensitivity))
    top.plot(modulus[order], ratio, color="tab:blue", marker="." if len(modulus) < 25 else None)
    band = np.abs(ratio) * np.minimum(error, 1.0)
    top.fill_between(modulus[order], ratio - band, ratio + band, color="tab:blue", alpha=0.2, label="bound on the error")
    top.set_ylabel("ratio of inner to outer film stress")
    bottom.plot(modulus[order], sensitivity, color="tab:orange", marker="." if len(modulus) < 25 else None)
    bottom.axhline(0.0, color="0.7", linewidth=0.8)
    bottom.set_ylabel("log-sensitivity  d ln ratio / d ln E")
    bottom.set_xlabel("Young's modulus of the inclusion, Pa")
    for axes in (top, bottom):
        axes.set_xscale("log")
        axes.grid(alpha=0.3)
        for value, style, name in ((tissue_modulus, ":", "tissue"), (scene_modulus, "--", "the scene's inclusion")):
            if value is not None and modulus.min() <= value <= modulus.max():
                axes.axvline(value, color="0.4", linestyle=style, linewidth=1.0, label=name)
    top.legend(loc="best", fontsize=9)
    top.set_title(f"{curve.evaluator}: {len(modulus)} moduli in {curve.seconds:.2g} s", fontsize=10)
    return save(figure, path)


def _numbers(values: tuple[float | None, ...]) -> np.ndarray:
    """Floats with gaps where there is no value."""
    return np.array([np.nan if value is None else value for value in values])
