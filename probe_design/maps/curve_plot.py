"""Draw a curve of ratio and log-sensitivity to a file."""

from __future__ import annotations

from pathlib import Path

from probe_design.pictures.formats import check_format, save_figure
from solver.results.figures import draw_curve
from solver.results.result import Curve


def plot(curve: Curve, path: Path, scene_modulus: float | None = None, tissue_modulus: float | None = None) -> Path:
    """Draw a curve to a file, with marks at the moduli of the scene's inclusion and tissue, Pa; return ``path``.

    Raises:
        InputError: see ``check_format``.
        OSError: the file cannot be written.
    """
    check_format(path)
    return save_figure(draw_curve(curve, scene_modulus, tissue_modulus), path)
