"""Search the gap that a design's force just closes, one evaluation of the limits at a time, and mark it on the gap's slider."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from probe_design.explorer.variables import Variable

if TYPE_CHECKING:
    from probe_design.explorer.limits import Limit

GAP_KEY = "probe.gap"
MAX_GAP_STEPS, GAP_TOLERANCE_RELATIVE = 8, 0.02  # evaluations of the limits; accuracy of the force at the marked gap


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
