"""Find equilibrium at one indentation: Newton's method within rounds of multipliers (augmented Lagrangians).

Its steps foresee which points touch at their end, and with what pressure (``contact_steps``). That pressure, not the one of the
gaps there, turns with the lines in the next tangent: it is as if the pressures were unknowns of Newton's method. The gaps differ
from those foreseen by the step squared, which a stiff penalty multiplies: with the pressures of these gaps steps are wrong, and
the residual tells nothing of their worth. Steps are therefore taken whole.

Where faces may open nothing is foreseen: far from equilibrium a stiff penalty makes Newton's method diverge there. Steps are
halved until the residual falls, and the first rounds are soft, with a kink that is rounded widely: points exert
pressure before they touch. Their multipliers carry the contact pressure in the last round, where the penalty has little effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from geometry.common.resources import check_time
from solver.contact.contact_steps import correct_step
from solver.contact.model import ContactModel, check_volume
from solver.contact.states import Equilibrium, Linearised, State

RESIDUAL_TOLERANCE = 1e-9  # residual over forces, in equilibrium
ROUNDING_RESIDUAL = 1e-7  # likewise, where rounding errors prevent a further decrease
ROUNDING_FACTOR = 4.0  # largest residual by the rounding of positions over its estimate; 0.3 to 2.4 was seen
MAX_NEWTON_STEPS, MAX_HALVINGS = 14, 6
MAX_STRAYING_STEPS = 5  # longer than one before them, where faces cannot open; with 3, fine corners ended at 0.75 of the load
MAX_OPENING_STEPS = 20  # where faces may open: the sets of touching and sliding points change between steps; 16 was seen
ROUNDS = ((1.0, 0.002),) * 8  # fraction of the penalty, and rounding in contact lengths
OPENING_ROUNDS = ((0.05, 0.04), (0.2, 0.01), (0.5, 0.002), *ROUNDS)  # likewise where faces may open
MAX_PENETRATION_RELATIVE = 1e-3  # contact lengths: deeper penetration requires another round
MAX_MISFIT_RELATIVE = 1e-2  # likewise, where rounds lessen it no further: lines that slide bend on edges of their own
MIN_DECREASE = 0.9  # of penetration from round to round; below it multipliers only wear a misfit of the lines down


def solve(model: ContactModel, start: State) -> Equilibrium:
    """Find equilibrium at the indentation of a state nearby: each round has better multipliers than the one before.

    Raises
    ------
    SolveError
        Newton's method does not converge, or an element folds over.
    LimitReached
        The time limit is reached.
    """
    check_volume(model.elements, start.elements)
    state, equations, residuals, deepest = start, None, list[float](), float("inf")
    for penalty_fraction, blur in OPENING_ROUNDS if model.may_open else ROUNDS:
        expected = None if model.may_open else state.multipliers
        state = replace(state, penalty_fraction=penalty_fraction, blur=blur, expected=expected)
        equations = model.linearise(state, equations)  # a new round changes contact alone, not the elements' part
        state, equations, round_residuals = _iterate_newton(model, state, equations)
        residuals += round_residuals
        if state.expected is not None and equations.has_contact:  # the tangent with the pressures of the gaps
            state = replace(state, expected=None)
            equations = model.linearise(state, equations)
        is_misfit = equations.deepest > MIN_DECREASE * deepest
        max_penetration, deepest = MAX_MISFIT_RELATIVE if is_misfit else MAX_PENETRATION_RELATIVE, equations.deepest
        if not equations.has_contact or (penalty_fraction == 1 and deepest <= max_penetration):
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


def _iterate_newton(model: ContactModel, state: State, equations: Linearised) -> tuple[State, Linearised, list[float]]:
    """Iterate Newton's method with fixed multipliers; return the state, its equations and the residual after each step.

    ``equations`` are those about the state to start from.
    """
    residuals, sizes, strayed = list[float](), list[float](), 0
    while equations.has_sliding_reversal or (
        equations.relative_residual > RESIDUAL_TOLERANCE
        and not _has_stalled(residuals, max(ROUNDING_RESIDUAL, _estimate_rounding(model, state, equations)))
    ):
        check_time("pressing")
        if len(residuals) == (MAX_OPENING_STEPS if model.may_open else MAX_NEWTON_STEPS) or strayed == MAX_STRAYING_STEPS:
            raise SolveError("Newton's method does not converge")
        equations = model.factorise_tangent(equations)
        assert equations.factor is not None
        step = -equations.factor.solve(np.ascontiguousarray(equations.residual[:, None]))[:, 0]
        if not np.all(np.isfinite(step)):
            raise SolveError("the equations cannot be solved")
        if model.may_open:
            state, equations = _take_step(model, state, equations, step)
            state = _store_sliding(state, equations)
        else:
            step, pressures = correct_step(model, state, equations, step)
            sizes.append(float(np.abs(step).max()))
            strayed += sizes[-1] > min(sizes)
            state, equations = _take_expected_step(model, state, equations, step, pressures)
        residuals.append(equations.relative_residual)
    return state, equations, residuals


def _estimate_rounding(model: ContactModel, state: State, equations: Linearised) -> float:
    """Return the relative residual that rounding errors of the gaps cause.

    A gap is a difference of positions: the penalty multiplies their rounding errors, which do not become less as loads do. Under
    light loads, and on a skin far stiffer than the tissue below it, they exceed the tolerance.
    """
    rows = zip(model.pairs, equations.touches, strict=True)
    stiffness = np.linalg.norm([np.linalg.norm(pair.penalty * pair.weights[touch.pressure != 0]) for pair, touch in rows])
    position_error = ROUNDING_FACTOR * float(np.finfo(float).eps) * model.section.tube_radius
    return state.penalty_fraction * position_error * float(stiffness) / equations.scale if equations.scale > 0 else 0.0


def _has_stalled(residuals: Sequence[float], rounding: float) -> bool:
    """Return whether the residuals no longer fall and are at most ``rounding``, the level of rounding errors."""
    return len(residuals) > 1 and residuals[-1] <= rounding and residuals[-1] > residuals[-2] / 2


def _take_expected_step(
    model: ContactModel, state: State, equations: Linearised, step: Floats, pressures: tuple[Floats, ...]
) -> tuple[State, Linearised]:
    """Take a Newton step that leads to given pressures, halved until no element folds over."""
    for step_fraction in 0.5 ** np.arange(MAX_HALVINGS):
        next_state = model.move(state, equations, step, step_fraction)
        if model.elements.compute_min_volume_ratio(next_state.elements.u) > 0:
            before = state.expected or pressures
            expected = tuple((1 - step_fraction) * a + step_fraction * b for a, b in zip(before, pressures, strict=True))
            next_state = replace(next_state, expected=expected)
            return next_state, model.linearise(next_state)
    raise SolveError("an element folds over")


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
