"""Polishing on the equivalent-inclusion level: the closed form, corrected to that level's value and slopes at the design.

With f the closed form's objective, g the level's and u the logarithms of the free variables,

    f(u) + g(u_0) - f(u_0) + (g'(u_0) - f'(u_0)) . (u - u_0)                                          (DS.3)

has the value and, by differences of ``LOG_DIFFERENCE_STEP``, the slopes of g at u_0: first-order model
management. It is climbed within
``MAX_LOG_CHANGE`` of the design; what is found counts only where g itself is larger there.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import ProbeError
from probe_design.design_search.choices import Choice, Progress
from probe_design.design_search.closed_search import TIGHT, polished
from probe_design.design_search.inclusion_model import inclusion_value
from probe_design.design_search.room import Room
from probe_design.design_search.steered_population import SteeredDesigns
from probe_design.populations.design_file import Design
from solver.closed_form.bessel import Array

DIFFERENCE, REACH = 0.03, 0.25  # of the logarithms
STEPS = 20  # of IPOPT


@dataclass(frozen=True)
class Corrected:
    """The closed-form objective corrected to the finer model at one design (eq. DS.3), for IPOPT."""

    steered: SteeredDesigns
    start: Floats
    slopes: Floats

    def gradient(self, x: Floats, poisson: tuple[float, float], which: list[int]) -> tuple[Floats, Floats]:
        """Return both values and their derivatives, see ``DesignObjective.gradient``."""
        both, slopes = self.steered.gradient(x, poisson, which)
        moved = np.log(x[which] / self.start[which])
        return both + np.array([float(self.slopes @ moved), 0.0]), slopes + np.stack([self.slopes, 0 * self.slopes])

    def values(self, x: Array, poisson: tuple[float, float]) -> tuple[Array, Array]:
        """Return what the closed form says, without the correction."""
        return self.steered.values(x, poisson)


def polish(steered: SteeredDesigns, design: Design, room: Room, start: Choice, progress: Progress) -> Choice | None:
    """Return a nearby design that the equivalent-inclusion evaluator finds better, or None."""
    space = room.pinned(start.combination)
    free = [k for k in range(len(space.low)) if space.low[k] < space.high[k] * (1 - TIGHT)]
    here = _value(steered, design, room, start, start.design)
    if not free or not np.isfinite(here):
        return None
    slopes = np.zeros(len(free))
    own = steered.gradient(start.design, start.combination.poisson, free)[1][0]
    for position, k in enumerate(free):
        progress(position, len(free) + 1)
        moved, step = _moved(start.design, k, space.low, space.high)
        there = _value(steered, design, room, start, moved)
        slopes[position] = (there - here) / step - own[position] if np.isfinite(there) else 0.0
    low = np.maximum(space.low, start.design * np.exp(-REACH))
    high = np.minimum(space.high, start.design * np.exp(REACH))
    corrected = Corrected(steered, start.design, slopes)
    near = replace(space, low=low, high=high)
    found = polished(corrected, near, start.design, poisson=start.combination.poisson, free=free, steps=STEPS)
    progress(len(free) + 1, len(free) + 1)
    if not _value(steered, design, room, start, found) > here:
        return None
    value = float(steered.real_values(found[:, None], start.combination.poisson)[0])
    return Choice(start.combination, found, value)


def _moved(design: Floats, k: int, low: Floats, high: Floats) -> tuple[Floats, float]:
    """Return a design with one variable moved away from its nearer bound, and the change of that variable's logarithm."""
    upwards = np.log(high[k] / design[k]) >= np.log(design[k] / low[k])
    moved = design.copy()
    moved[k] = np.clip(design[k] * np.exp(DIFFERENCE if upwards else -DIFFERENCE), low[k], high[k])
    return moved, float(np.log(moved[k] / design[k]))


def _value(steered: SteeredDesigns, design: Design, room: Room, start: Choice, at: Floats) -> float:
    scene = room.exact_scene(at, start.combination)
    if scene is None:
        return -np.inf
    with suppress(ProbeError):
        return inclusion_value(steered, design, scene)
    return -np.inf
