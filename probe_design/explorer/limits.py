"""Limits of a design, and where on the sliders each binds: linear elasticity, the gap that stays open, and the wall.

The gap that a design's force just closes is searched by one evaluation of the limits at a time.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

from scipy.optimize import brentq

from geometry.common.errors import InputError
from geometry.scenes.probe import Probe
from geometry.scenes.scene import Scene
from geometry.scenes.units import MM_PER_M
from probe_design.explorer.variables import Variable, get_value
from probe_design.workshop.rounding import MIN_WALL_M
from solver.results.load_limits import LargestLoad
from solver.results.result import Result

LOADS = (("load.force", "force"), ("load.indentation", "indentation"))
LOAD_LIMITS = (
    ("L", "linear_limit_load", "linear elasticity holds up to"),
    ("G", "gap_closure_load", "the gap stays open up to"),
)
WALL_KEYS = ("probe.inner_radius", "probe.area_ratio", "probe.outer_radius", "probe.gap")

GAP_KEY = "probe.gap"
MAX_GAP_STEPS, GAP_TOLERANCE_RELATIVE = 8, 0.02  # evaluations of the limits; accuracy of the force at the marked gap


@dataclass(frozen=True)
class Limit:
    """A limit of the design.

    Attributes
    ----------
    sign
        With which it is marked.
    text
        The statement.
    is_kept
        Whether the design keeps to it.
    marks
        Value of a number, SI, at which it binds, by key; numbers beyond whose slider's range it binds are left out.
    """

    sign: str
    text: str
    is_kept: bool
    marks: dict[str, float]


def list_limits(scene: Scene, result: Result, min_wall: float | None, variables: Sequence[Variable]) -> list[Limit]:
    """Return the limits of a design, given its result by the formulas; ``min_wall``, m, is that of the design file."""
    known = {variable.key: variable for variable in variables}
    limits = []
    for sign, name, words in LOAD_LIMITS:
        limit: LargestLoad | None = getattr(result, name)
        for key, quantity in LOADS:
            if limit is not None and (variable := known.get(key)) is not None:
                value, load = getattr(limit, quantity), get_value(scene, key)
                text = f"{words} {variable.format_value(float(f'{value:.3g}'))} ({limit.by})"
                marks = {key: value} if variable.low <= value <= variable.high else {}
                limits.append(Limit(sign, text, load is None or load <= value, marks))
    wall, minimum = scene.probe.tube_radius - scene.probe.hole_radius, MIN_WALL_M if min_wall is None else min_wall
    text = f"the outer block's wall is {_format_mm(wall)}, at least {_format_mm(minimum)}"
    limits.append(Limit("W", text, wall >= minimum * (1 - 1e-9), find_wall_marks(scene.probe, minimum, variables)))
    return limits


def find_wall_marks(probe: Probe, wall: float, variables: Sequence[Variable]) -> dict[str, float]:
    """Return the value of each size, SI, at which the outer block is ``wall`` thick, m, while the others stay."""
    marks = {}
    for variable in variables:
        if variable.key in WALL_KEYS:
            name = variable.key.removeprefix("probe.")

            def measure(value: float, name: str = name) -> float:
                """Return the wall's excess over its limit, m."""
                other = probe.model_copy(update={name: value})
                return other.tube_radius - other.hole_radius - wall

            if measure(variable.low) * measure(variable.high) < 0:  # the wall is monotonic in each size
                marks[variable.key] = float(brentq(measure, variable.low, variable.high, rtol=1e-9, xtol=1e-12))
    return marks


def _format_mm(length: float) -> str:
    """Write a length, m, in mm with three digits."""
    return f"{MM_PER_M * length:.3g} mm"


def search_gap(scene: Scene, closure: float, variable: Variable) -> Generator[Scene, float | None, float | None]:
    """Search the gap that the scene's force just closes, to which the force that closes it is about proportional.

    Parameters
    ----------
    scene
        The design, with a force above 0.
    closure
        Largest force at which its gap stays open, N.
    variable
        The gap's.

    Yields
    ------
    Scene
        The design with another gap, for which that force, or None, is to be sent.

    Returns
    -------
    float or None
        The gap, m; None where the force closes none within the slider's range, or another limit comes first.
    """
    force, gap = scene.load.force or 0.0, scene.probe.gap
    for _ in range(MAX_GAP_STEPS):
        gap *= force / closure
        if not variable.low <= gap <= variable.high:
            return None
        try:
            design = scene.replace({GAP_KEY: gap})
        except InputError:
            return None
        last, closure = closure, (yield design) or 0.0
        if abs(closure / force - 1) < GAP_TOLERANCE_RELATIVE:
            return gap
        if closure == 0.0 or (last < force and closure < (1 + GAP_TOLERANCE_RELATIVE) * last):
            return None
    return None


def mark_gap(limits: Sequence[Limit], gap: float) -> list[Limit]:
    """Return limits of which that of the gap's closure is marked on the gap, m, too."""
    return [replace(limit, marks={**limit.marks, GAP_KEY: gap}) if limit.sign == "G" else limit for limit in limits]
