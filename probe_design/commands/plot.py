"""Draw any result that has a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geometry.common.calls import check_call
from geometry.common.errors import InputError, Words
from geometry.scenes.scene import Scene
from probe_design.locating.figures import draw_location
from probe_design.locating.location import Location
from probe_design.maps.detectability import Detectability
from probe_design.maps.scan import Scan
from probe_design.reporting.curve_figures import draw_curve, draw_load_curve
from probe_design.reporting.detectability_figure import draw_detectability
from probe_design.reporting.scan_figure import draw_scan
from probe_design.tolerancing.budget import ToleranceBudget
from probe_design.tolerancing.plot import draw_budget
from solver import Curve, LoadCurve

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLOTTED = "a result of curve, press, scan, detectability, locate or tolerances"


@check_call
def plot(result: Curve | LoadCurve | Scan | Detectability | Location | ToleranceBudget) -> Figure:
    """Draw a result as its command does with ``--plot``.

    Parameters
    ----------
    result
        Of ``curve``, ``press``, ``scan``, ``detectability``, ``locate`` or ``tolerances``.

    Returns
    -------
    Figure
        Its ``savefig`` writes it to a file.

    Raises
    ------
    InputError
        The result has no picture, or is a map or scan that carries no scene.
    """
    match result:
        case Curve():
            return draw_curve(result)
        case LoadCurve():
            return draw_load_curve(result)
        case Scan():
            return draw_scan(result, _require_scene(result.scene))
        case Detectability():
            return draw_detectability(result, _require_scene(result.scene))
        case Location():
            return draw_location(result)
        case ToleranceBudget():
            return draw_budget(result)
    raise InputError("result", Words(f"an object of type {type(result).__name__}"), PLOTTED)


def _require_scene(scene: Scene | None) -> Scene:
    """Return the scene of a result, or refuse a result without it."""
    if scene is None:
        raise InputError("scene", Words("missing"), "a result that the toolkit made, which carries its scene")
    return scene
