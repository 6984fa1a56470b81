"""Equilibrium at one indentation: Newton's method within rounds of multipliers (augmented Lagrangians).

A stiff penalty throws Newton's method off until it is near: the first round is soft and its kink is rounded widely, so that
points that are about to touch are felt before they do; the multipliers it leaves make the last round's penalty hard to notice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import SolveError
from geometry.common.resources import check_time
from solver.contact.model import ContactModel, check_volume
from solver.contact.states import Linearised, State

BALANCED = 1e-9  # residual over forces of a state in equilibrium
ROUNDED = 1e-7  # likewise, where rounding keeps it from falling further
MOST_STEPS, HALVINGS = 14, 6
MORE_STEPS = 40  # where faces may open: which points touch and slide is found by trying
ROUNDS = ((0.1, 0.02), *((1.0, 0.002),) * 8)  # shares of the penalty; rounding, in contact lengths
SLOW_ROUNDS = ((0.05, 0.04), (0.2, 0.01), (0.5, 0.002), *((1.0, 0.002),) * 8)  # likewise where faces may open, or those fail
PENETRATION = 1e-3  # contact lengths: deeper ones ask for another round


@dataclass(frozen=True)
class Equilibrium:
    """A state in balance.

    Attributes:
        state: it.
        at: the equations about it.
        residuals: after each step of Newton's method, relative; rounds one after the other.
    """

    state: State
    at: Linearised
    residuals: tuple[float, ...]


def solve(model: ContactModel, start: State, target: Bools | None = None) -> Equilibrium:
    """Find equilibrium at the indentation of a state.

    Args:
        model: of the section.
        start: what is near it.
        target: see ``Elements.tangent``.

    Raises:
        SolveError: none was found: Newton's method does not converge, or an element folds over.
        LimitReached: the time is over.
    """
    if not model.loose:
        try:
            return _solved(model, start, target, ROUNDS)
        except SolveError:
            pass
    return _solved(model, start, target, SLOW_ROUNDS)


def _solved(model: ContactModel, start: State, target: Bools | None, rounds: Sequence[tuple[float, float]]) -> Equilibrium:
    """Equilibrium by some rounds."""
    state, residuals = start, []
    for share, blur in rounds:
        state, at, some = _balanced(model, replace(state, share=share, blur=blur), target)
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


def _balanced(model: ContactModel, state: State, target: Bools | None) -> tuple[State, Linearised, list[float]]:
    """Newton's method with the multipliers held."""
    check_volume(model.elements, state.elements)
    at = model.linearised(state, target)
    residuals: list[float] = []
    while at.torn or (at.unbalanced > BALANCED and not _stands_still(residuals)):
        check_time("pressing")
        if len(residuals) == (MORE_STEPS if model.loose else MOST_STEPS):
            raise SolveError("Newton's method does not converge")
        step = -model.factor(at).solve(np.ascontiguousarray(at.residual[:, None]))[:, 0]
        if not np.all(np.isfinite(step)):
            raise SolveError("the equations cannot be solved")
        state, at = _moved(model, state, at, step, target)
        state = _slid(state, at)
        residuals.append(at.unbalanced)
    return state, at, residuals


def _stands_still(residuals: Sequence[float]) -> bool:
    """Whether only rounding is left."""
    return len(residuals) > 1 and residuals[-1] <= ROUNDED and residuals[-1] > residuals[-2] / 2


def _moved(model: ContactModel, state: State, at: Linearised, step: Floats, target: Bools | None) -> tuple[State, Linearised]:
    """The state after a step, halved until no element folds over and forces are nearer to balance, or halving helps no more."""
    edge = (model.numbering.gather @ step).reshape(model.lift.shape[:2])
    best: tuple[State, Linearised] | None = None
    for share in 0.5 ** np.arange(HALVINGS):
        elements = model.elements.moved(state.elements, at.tangent, edge, share)
        if model.elements.least_volume(elements.u) <= 0:
            continue
        moved = replace(state, v=state.v + share * step, elements=elements)
        tried = moved, model.linearised(moved, target)
        if best is not None and tried[1].unbalanced >= best[1].unbalanced:
            break
        best = tried
        if best[1].torn or best[1].unbalanced <= at.unbalanced:  # forces of points that are held at last are no measure
            break
    if best is None:
        raise SolveError("an element folds over")
    return best
