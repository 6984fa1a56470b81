"""Draw a load curve to a file."""

from __future__ import annotations

from pathlib import Path

from probe_design.pictures.formats import check_format, save_figure
from solver.results.figures import draw_load_curve
from solver.results.load_curve import LoadCurve


def plot(curve: LoadCurve, path: Path) -> Path:
    """Draw a load curve to a file; return ``path``.

    Raises:
        InputError: see ``check_format``.
        OSError: the file cannot be written.
    """
    check_format(path)
    return save_figure(draw_load_curve(curve), path)
