"""Equilibrium at one indentation: Newton's method within rounds of multipliers (augmented Lagrangians).

A stiff penalty throws Newton's method off until it is near: the first round is soft and its kink is rounded widely, so that
points that are about to touch are felt before they do; the multipliers it leaves make the last round's penalty hard to notice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from geometry.common.resources import check_time
from solver.contact.model import ContactModel, check_volume
from solver.contact.states import Linearised, State

BALANCED = 1e-9  # residual over forces of a state in equilibrium
NEARLY = (
    1e-6  # likewise: the tangent there is that of equilibrium, one step with it leads there, and forces alone tell that it did
)
ROUNDED = 1e-7  # likewise, where rounding keeps it from falling further
ROUNDED_LIGHT = 1e-11  # likewise, over the indentation in outer radii: of light loads distances are rounded to a larger share
GUESSED = 1e-5  # likewise, of a round whose multipliers are the next one's guess
MOST_STEPS, HALVINGS = 14, 6
MORE_STEPS = 40  # where faces may open: which points touch and slide is found by trying
ROUNDS = ((0.1, 0.02), *((1.0, 0.002),) * 8)  # shares of the penalty; rounding, in contact lengths
SHARP_ROUNDS = ROUNDS[1:]  # likewise, where multipliers are known from the loads before
SLOW_ROUNDS = ((0.05, 0.04), (0.2, 0.01), (0.5, 0.002), *((1.0, 0.002),) * 8)  # likewise where faces may open, or those fail
PENETRATION = 1e-3  # contact lengths: deeper ones ask for another round


@dataclass(frozen=True)
class Equilibrium:
    """A state in balance.

    Attributes:
        state: it.
        at: the equations about it; its tangent may be that of a state within ``NEARLY`` of it.
        residuals: after each step of Newton's method, relative; rounds one after the other.
    """

    state: State
    at: Linearised
    residuals: tuple[float, ...]


def solve(model: ContactModel, start: State, *, known: bool = False) -> Equilibrium:
    """Find equilibrium at the indentation of a state.

    Args:
        model: of the section.
        start: what is near it.
        known: whether its multipliers are a guess of those there, as they follow from the loads before.

    Raises:
        SolveError: none was found: Newton's method does not converge, or an element folds over.
        LimitReached: the time is over.
    """
    tries = [*([SHARP_ROUNDS] if known else []), *([] if model.loose else [ROUNDS]), SLOW_ROUNDS]
    for rounds in tries[:-1]:
        try:
            return _solved(model, start, rounds)
        except SolveError:
            pass
    return _solved(model, start, tries[-1])


def _solved(model: ContactModel, start: State, rounds: Sequence[tuple[float, float]]) -> Equilibrium:
    """Equilibrium by some rounds."""
    state, at, residuals = start, None, list[float]()
    for share, blur in rounds:
        enough = GUESSED if share < 1 and not model.loose else BALANCED
        state, at, some = _balanced(model, replace(state, share=share, blur=blur), at, enough)
        residuals += some
        if not at.touched and at.unbalanced > BALANCED:
            state, at, some = _balanced(model, state, at)
            residuals += some
        if not at.touched or (share == 1 and at.deepest <= PENETRATION):
            return Equilibrium(_remembered(state, at), at, tuple(residuals))
        state = replace(state, multipliers=tuple(one.pressure for one in at.touches))
    raise SolveError("contact does not settle")


def _remembered(state: State, at: Linearised) -> State:
    """A state in balance as the one that further loads begin at."""
    both = zip(state.grips, at.touches, strict=True)
    return replace(state, grips=tuple(None if grip is None else touch.grip for grip, touch in both))


def _slid(state: State, at: Linearised) -> State:
    """A state that knows which of its points slide."""
    both = zip(state.grips, at.touches, strict=True)
    return replace(
        state, grips=tuple(None if grip is None else replace(grip, sliding=touch.grip.sliding) for grip, touch in both)
    )


def _balanced(
    model: ContactModel, state: State, known: Linearised | None, enough: float = BALANCED
) -> tuple[State, Linearised, list[float]]:
    """Newton's method with the multipliers held, from a state of which what elements do may be ``known``."""
    check_volume(model.elements, state.elements)
    at = model.linearised(state, known)
    residuals: list[float] = []
    rounded = max(ROUNDED, ROUNDED_LIGHT * model.section.tube_radius / state.indentation) if state.indentation > 0 else ROUNDED
    while at.torn or (at.unbalanced > enough and not _stands_still(residuals, rounded)):
        check_time("pressing")
        if len(residuals) == (MORE_STEPS if model.loose else MOST_STEPS):
            raise SolveError("Newton's method does not converge")
        at = model.factored(at)
        assert at.factor is not None
        step = -at.factor.solve(np.ascontiguousarray(at.residual[:, None]))[:, 0]
        if not np.all(np.isfinite(step)):
            raise SolveError("the equations cannot be solved")
        if at.unbalanced <= NEARLY and not model.loose:
            there = model.moved(state, at, step)
            last = model.balanced(there, at)
            if last.unbalanced <= BALANCED:
                return there, last, [*residuals, last.unbalanced]
        state, at = _moved(model, state, at, step)
        state = _slid(state, at)
        residuals.append(at.unbalanced)
    return state, at, residuals


def _stands_still(residuals: Sequence[float], rounded: float) -> bool:
    """Whether only rounding is left, which may be that much."""
    return len(residuals) > 1 and residuals[-1] <= rounded and residuals[-1] > residuals[-2] / 2


def _moved(model: ContactModel, state: State, at: Linearised, step: Floats) -> tuple[State, Linearised]:
    """The state after a step, halved until no element folds over and forces are nearer to balance, or halving helps no more."""
    best: tuple[State, Linearised] | None = None
    for share in 0.5 ** np.arange(HALVINGS):
        moved = model.moved(state, at, step, share)
        if model.elements.least_volume(moved.elements.u) <= 0:
            continue
        tried = moved, model.linearised(moved)
        if best is not None and tried[1].unbalanced >= best[1].unbalanced:
            break
        best = tried
        if best[1].torn or best[1].unbalanced <= at.unbalanced:  # forces of points that are held at last are no measure
            break
    if best is None:
        raise SolveError("an element folds over")
    return best
