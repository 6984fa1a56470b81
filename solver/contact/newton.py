"""Find equilibrium at one indentation: Newton's method within rounds of multipliers (augmented Lagrangians).

Far from equilibrium a stiff penalty makes Newton's method diverge. The first round is therefore soft, and its kink is rounded
widely, so that points exert pressure before they touch. Its multipliers carry the contact pressure in the last round, where the
penalty then has little effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from geometry.common.resources import check_time
from solver.contact.model import ContactModel, check_volume
from solver.contact.states import Equilibrium, Linearised, State

RESIDUAL_TOLERANCE = 1e-9  # residual over forces, in equilibrium
ROUNDING_RESIDUAL = 1e-7  # likewise, where rounding errors prevent a further decrease
LIGHT_ROUNDING_RESIDUAL = 1e-11  # likewise, divided by the indentation in outer radii
GUESS_RESIDUAL_TOLERANCE = 1e-5  # likewise, of a round that only gives the next one's multipliers
MAX_NEWTON_STEPS, MAX_HALVINGS = 14, 6
MAX_OPENING_STEPS = 40  # where faces may open: the sets of touching and sliding points change between steps
PENALTY_ROUNDS = ((0.1, 0.02), *((1.0, 0.002),) * 8)  # fraction of the penalty, and rounding in contact lengths
SHARP_ROUNDS = PENALTY_ROUNDS[1:]  # likewise, where multipliers are known from the loads before
SLOW_ROUNDS = ((0.05, 0.04), (0.2, 0.01), (0.5, 0.002), *((1.0, 0.002),) * 8)  # likewise where faces may open, or those fail
Rounds = tuple[tuple[float, float], ...]  # like these
MAX_PENETRATION_RELATIVE = 1e-3  # contact lengths: deeper penetration requires another round


def solve(model: ContactModel, start: State, schedules: list[Rounds], *, known: bool = False) -> Equilibrium:
    """Find equilibrium at the indentation of a state.

    Parameters
    ----------
    model
        Model of the section.
    start
        A state near equilibrium, at the wanted indentation.
    schedules
        Rounds to try, one schedule after the other. What fails goes to the end, as it would mostly fail at the next load again.
    known
        Whether its multipliers are extrapolated from earlier loads.

    Raises
    ------
    SolveError
        Newton's method does not converge, or an element folds over.
    LimitReached
        The time limit is reached.
    """
    if known:
        with suppress(SolveError):
            return _solve_rounds(model, start, SHARP_ROUNDS)
    for _ in schedules[1:]:
        with suppress(SolveError):
            return _solve_rounds(model, start, schedules[0])
        schedules.append(schedules.pop(0))
    return _solve_rounds(model, start, schedules[0])


def _solve_rounds(model: ContactModel, start: State, rounds: Rounds) -> Equilibrium:
    """Find equilibrium by rounds of Newton's method, each with better multipliers than the one before.

    ``rounds`` give the fraction of the penalty and the rounding, in contact lengths; see ``PENALTY_ROUNDS``.
    """
    check_volume(model.elements, start.elements)
    state, equations, residuals = start, None, list[float]()
    for penalty_fraction, blur in rounds:
        tolerance = GUESS_RESIDUAL_TOLERANCE if penalty_fraction < 1 and not model.may_open else RESIDUAL_TOLERANCE
        state = replace(state, penalty_fraction=penalty_fraction, blur=blur)
        equations = model.linearise(state, equations)  # a new round changes contact alone, not the elements' part
        state, equations, round_residuals = _iterate_newton(model, state, equations, tolerance)
        residuals += round_residuals
        # without contact no further round follows: finish this one to the full tolerance
        if not equations.has_contact and equations.relative_residual > RESIDUAL_TOLERANCE:
            state, equations, round_residuals = _iterate_newton(model, state, equations)
            residuals += round_residuals
        if not equations.has_contact or (penalty_fraction == 1 and equations.deepest <= MAX_PENETRATION_RELATIVE):
            return Equilibrium(_store_grips(state, equations), equations, tuple(residuals))
        state = replace(state, multipliers=tuple(touch.pressure for touch in equations.touches))
    raise SolveError("contact does not settle")


def _store_grips(state: State, equations: Linearised) -> State:
    """Return an equilibrium state with its friction history updated, as the start of further loads."""
    rows = zip(state.grips, equations.touches, strict=True)
    return replace(state, grips=tuple(None if grip is None else touch.grip for grip, touch in rows))


def _store_sliding(state: State, equations: Linearised) -> State:
    """Return a state that records which of its points slide."""
    rows = zip(state.grips, equations.touches, strict=True)
    return replace(
        state, grips=tuple(None if grip is None else replace(grip, sliding=touch.grip.sliding) for grip, touch in rows)
    )


def _iterate_newton(
    model: ContactModel, state: State, equations: Linearised, tolerance: float = RESIDUAL_TOLERANCE
) -> tuple[State, Linearised, list[float]]:
    """Iterate Newton's method with fixed multipliers; return the state, its equations and the residual after each step.

    Parameters
    ----------
    model, state
        The model and the state to start from.
    equations
        The equations about that state.
    tolerance
        Relative residual at which the iteration ends.
    """
    residuals: list[float] = []
    rounding = (
        max(ROUNDING_RESIDUAL, LIGHT_ROUNDING_RESIDUAL * model.section.tube_radius / state.indentation)
        if state.indentation > 0
        else ROUNDING_RESIDUAL
    )
    while equations.has_sliding_reversal or (equations.relative_residual > tolerance and not _has_stalled(residuals, rounding)):
        check_time("pressing")
        if len(residuals) == (MAX_OPENING_STEPS if model.may_open else MAX_NEWTON_STEPS):
            raise SolveError("Newton's method does not converge")
        equations = model.factorise_tangent(equations)
        assert equations.factor is not None
        step = -equations.factor.solve(np.ascontiguousarray(equations.residual[:, None]))[:, 0]
        if not np.all(np.isfinite(step)):
            raise SolveError("the equations cannot be solved")
        state, equations = _take_step(model, state, equations, step)
        state = _store_sliding(state, equations)
        residuals.append(equations.relative_residual)
    return state, equations, residuals


def _has_stalled(residuals: Sequence[float], rounding: float) -> bool:
    """Return whether the residuals no longer fall and are at most ``rounding``, the level of rounding errors."""
    return len(residuals) > 1 and residuals[-1] <= rounding and residuals[-1] > residuals[-2] / 2


def _take_step(model: ContactModel, state: State, equations: Linearised, step: Floats) -> tuple[State, Linearised]:
    """Take a Newton step, halved until no element folds over and the residual falls, or halving stops helping.

    Returns the next state and the equations about it; ``step`` is the change of the unknowns, shape (unknowns,). Halved steps are
    tried with the elements' tangent of the state before, which changes little in the residual and takes half of the time.
    """
    best: tuple[State, Linearised] | None = None
    for step_fraction in 0.5 ** np.arange(MAX_HALVINGS):
        next_state = model.move(state, equations, step, step_fraction)
        if model.elements.compute_min_volume_ratio(next_state.elements.u) <= 0:
            continue
        is_whole = step_fraction == 1
        trial = next_state, model.linearise(next_state, None if is_whole else equations, keep_tangent=not is_whole)
        if best is not None and trial[1].relative_residual >= best[1].relative_residual:
            break
        best = trial
        if (
            best[1].has_sliding_reversal or best[1].relative_residual <= equations.relative_residual
        ):  # residuals of points that stop sliding cannot be compared
            break
    if best is None:
        raise SolveError("an element folds over")
    next_state, next_equations = best
    return next_state, next_equations if next_equations.factor is None else model.linearise(next_state)
