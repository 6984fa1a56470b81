"""Find equilibrium at one indentation: Newton's method within rounds of multipliers (augmented Lagrangians).

Far from equilibrium a stiff penalty makes Newton's method diverge. The first round is therefore soft, and its kink is rounded
widely, so that points exert pressure before they touch. Its multipliers carry the contact pressure in the last round, where the
penalty then has little effect.
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

BALANCED = 1e-9  # residual over forces, in equilibrium
NEARLY = (
    1e-6  # likewise: the tangent there is that of equilibrium, one step with it leads there, and forces alone tell that it did
)
ROUNDED = 1e-7  # likewise, where rounding errors prevent a further decrease
ROUNDED_LIGHT = 1e-11  # likewise, divided by the indentation in outer radii
GUESSED = 1e-5  # likewise, of a round that only gives the next one's multipliers
MOST_STEPS, HALVINGS = 14, 6
MORE_STEPS = 40  # where faces may open: the sets of touching and sliding points change between steps
ROUNDS = ((0.1, 0.02), *((1.0, 0.002),) * 8)  # share of the penalty, and rounding in contact lengths
SHARP_ROUNDS = ROUNDS[1:]  # likewise, where multipliers are known from the loads before
SLOW_ROUNDS = ((0.05, 0.04), (0.2, 0.01), (0.5, 0.002), *((1.0, 0.002),) * 8)  # likewise where faces may open, or those fail
PENETRATION = 1e-3  # contact lengths: deeper penetration requires another round


@dataclass(frozen=True)
class Equilibrium:
    """A state in equilibrium.

    Attributes:
        state: the state.
        equations: the equations about it; their tangent may be that of a state within ``LAST_STEP_RESIDUAL`` of it.
        residuals: relative residual after each Newton step, of all rounds in order.
    """

    state: State
    at: Linearised
    residuals: tuple[float, ...]


def solve(model: ContactModel, start: State, *, known: bool = False) -> Equilibrium:
    """Find equilibrium at the indentation of a state.

    Args:
        model: model of the section.
        start: a state near equilibrium, at the wanted indentation.
        known: whether its multipliers are extrapolated from earlier loads.

    Raises:
        SolveError: Newton's method does not converge, or an element folds over.
        LimitReached: the time limit is reached.
    """
    tries = [*([SHARP_ROUNDS] if known else []), *([] if model.loose else [ROUNDS]), SLOW_ROUNDS]
    for rounds in tries[:-1]:
        try:
            return _solved(model, start, rounds)
        except SolveError:
            pass
    return _solved(model, start, tries[-1])


def _solved(model: ContactModel, start: State, rounds: Sequence[tuple[float, float]]) -> Equilibrium:
    """Find equilibrium by the given rounds."""
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
    """Return an equilibrium state with its friction history updated, as the start of further loads."""
    both = zip(state.grips, at.touches, strict=True)
    return replace(state, grips=tuple(None if grip is None else touch.grip for grip, touch in both))


def _slid(state: State, at: Linearised) -> State:
    """Return a state that records which of its points slide."""
    both = zip(state.grips, at.touches, strict=True)
    return replace(
        state, grips=tuple(None if grip is None else replace(grip, sliding=touch.grip.sliding) for grip, touch in both)
    )


def _balanced(
    model: ContactModel, state: State, known: Linearised | None, enough: float = BALANCED
) -> tuple[State, Linearised, list[float]]:
    """Iterate Newton's method with fixed multipliers; ``known`` may give the elements' part of the first linearisation."""
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
    """Return whether the residuals no longer fall and are at most ``rounded``, the level of rounding errors."""
    return len(residuals) > 1 and residuals[-1] <= rounded and residuals[-1] > residuals[-2] / 2


def _moved(model: ContactModel, state: State, at: Linearised, step: Floats) -> tuple[State, Linearised]:
    """Take a Newton step, halved until no element folds over and the residual falls, or halving stops helping."""
    best: tuple[State, Linearised] | None = None
    for share in 0.5 ** np.arange(HALVINGS):
        moved = model.moved(state, at, step, share)
        if model.elements.least_volume(moved.elements.u) <= 0:
            continue
        tried = moved, model.linearised(moved)
        if best is not None and tried[1].unbalanced >= best[1].unbalanced:
            break
        best = tried
        if best[1].torn or best[1].unbalanced <= at.unbalanced:  # residuals of points that stop sliding cannot be compared
            break
    if best is None:
        raise SolveError("an element folds over")
    return best
