"""Compute outputs, map, limits and curves of a design: the program of ``formulas``, in a process of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from geometry.scenes.scene import Scene
from probe_design.explorer import quick
from probe_design.explorer.charts_svg import draw_curves, draw_map
from probe_design.explorer.limits import Limit, list_limits
from probe_design.explorer.variables import Variable
from probe_design.maps.sphere_effects import Thresholds
from solver.results.result import Result


def run(request: tuple[str, tuple[Any, ...]]) -> object:
    """Return the response to a request: a name of ``FUNCTIONS``, and its arguments; raises where a design is refused."""
    name, arguments = request
    return FUNCTIONS[name](*arguments)


def compute_map(scene: Scene, noise: float) -> str:
    """Return the map of detection as SVG; ``noise`` is relative."""
    return draw_map(quick.compute_map(scene, Thresholds(noise)), scene)


def compute_limits(
    scene: Scene, min_wall: float | None, variables: Sequence[Variable]
) -> tuple[list[str], list[Limit], float | None]:
    """Return warnings, limits and the force, N, up to which the gap stays open; ``min_wall``, m, is that of the design file."""
    result = quick.evaluate_with_limits(scene)
    return list(result.warnings), list_limits(scene, result, min_wall, variables), _get_closure(result)


def compute_closure(scene: Scene) -> float | None:
    """Return the force up to which the gap stays open, N; None where it is not known."""
    return _get_closure(quick.evaluate_with_limits(scene))


def _get_closure(result: Result) -> float | None:
    """Return the force up to which the gap stays open, N; None where the gap does not limit it."""
    load = result.gap_closure_load
    return None if load is None else load.force


def compute_curves(scene: Scene, variables: Sequence[Variable]) -> str:
    """Return the curves around a design as SVG."""
    names = ["ratio", "log_sensitivity", "stiffness", *(["charge_ratio"] if scene.probe.film is not None else [])]
    return draw_curves(quick.compute_curves(scene, variables), names)


FUNCTIONS: dict[str, Callable[..., object]] = {
    "load": lambda: None,
    "outputs": quick.evaluate_outputs,
    "map": compute_map,
    "limits": compute_limits,
    "curves": compute_curves,
    "closure": compute_closure,
}
