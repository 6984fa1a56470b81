r"""Correct Newton steps for points that begin or cease to touch within the step.

A step of Newton's method takes those points to touch at its end that touch at its start. Where they change, their stiff penalty
throws the next step far off. The linearised equations are therefore solved with the pressures at the end of the step: with the
tangent K, the step s, and the derivatives G of the gaps g with respect to the unknowns,

    K s = -residual + G' W q,   q = p(g + G s) - p(g) - p'(g) G s                                      (CT.14)

with the pressure p of eq. CT.3 and the points' areas W. q is zero where the pressure stays linear; the few other points form a
small dense system, solved by Newton's method.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Bools, Floats, Ints
from solver.contact.contact_forces import compute_pressure
from solver.contact.model import ContactModel
from solver.contact.states import Linearised, State

REACH_FACTOR = 10.0  # times the largest change of an unknown: a gap changes less in one step
NEGLIGIBLE_RELATIVE = 1e-6  # of the largest pressure: a smaller q is left out
MAX_PASSES = 4  # each takes in the points that the correction of those before presses or frees
MAX_STEPS, MAX_HALVINGS, TOLERANCE_RELATIVE = 40, 8, 1e-9  # of Newton's method for q; tolerance relative to its first error


@dataclass(frozen=True)
class NearPoints:
    """Points of all pairs that may begin or cease to touch, and their pressures as their gaps change.

    Attributes
    ----------
    trial, penalties, blurs
        l - e g of eq. CT.3, Pa, its penalty e, Pa/m, and rounding, Pa, shape (points,) each.
    """

    trial: Floats
    penalties: Floats
    blurs: Floats

    def select(self, points: Bools) -> NearPoints:
        """Return the points of a mask."""
        return NearPoints(self.trial[points], self.penalties[points], self.blurs[points])

    def compute_pressure(self, opening: Floats | float = 0.0) -> Floats:
        """Return the pressures where gaps change by ``opening``, m, shape (points,)."""
        return compute_pressure(self.trial - self.penalties * opening, self.blurs)[0]

    def compute_surplus(self, opening: Floats) -> tuple[Floats, Floats]:
        """Return q of eq. CT.14, Pa, where gaps change by ``opening``, m, shape (points,), and its derivative."""
        now, rising_now = compute_pressure(self.trial, self.blurs)
        then, rising = compute_pressure(self.trial - self.penalties * opening, self.blurs)
        return then - now + self.penalties * rising_now * opening, self.penalties * (rising_now - rising)


def correct_step(model: ContactModel, state: State, equations: Linearised, step: Floats) -> tuple[Floats, tuple[Floats, ...]]:
    """Correct a Newton step, shape (unknowns,), by eq. CT.14, and return with it each pair's pressures at its end, Pa.

    Where no correction is found the step remains as it is. The equations have their factor; no face slides or opens.
    """
    assert equations.factor is not None
    points, weights, gradients, close = _find_near(model, state, equations, REACH_FACTOR * float(np.abs(step).max()))
    opening, pressures = gradients @ step, tuple(np.zeros(pair.points) for pair in model.pairs)
    moves = _find_correction(equations, points, weights, gradients, opening) if len(opening) else None
    if moves is not None:
        step, opening = step + moves, opening + gradients @ moves
    ends = np.cumsum([np.count_nonzero(mask) for mask in close])[:-1]
    for pressure, mask, values in zip(pressures, close, np.split(points.compute_pressure(opening), ends), strict=True):
        pressure[mask] = values
    return step, pressures


def _find_correction(
    equations: Linearised, points: NearPoints, weights: Floats, gradients: Floats, opening: Floats
) -> Floats | None:
    """Return what eq. CT.14 adds to a step that opens the gaps by ``opening``; None for nothing, or if it is not found.

    The other parameters are those of ``_find_near``.
    """
    assert equations.factor is not None
    surplus = np.abs(points.compute_surplus(opening)[0])
    pressure = points.compute_pressure()
    negligible = NEGLIGIBLE_RELATIVE * max(float(pressure.max()), float(surplus.max()))
    if not np.any(surplus > negligible):
        return None
    chosen = (surplus > negligible) | (pressure > 0)
    for _ in range(MAX_PASSES):
        moves = equations.factor.solve(np.ascontiguousarray(gradients[chosen].T * weights[chosen]))
        compliance = gradients @ moves
        solution = _solve_surplus(points.select(chosen), opening[chosen], compliance[chosen])
        if solution is None:
            return None
        missed = (np.abs(points.compute_surplus(opening + compliance @ solution)[0]) > negligible) & ~chosen
        if not np.any(missed):
            return np.asarray(moves @ solution)
        chosen |= missed
    return None


def _find_near(
    model: ContactModel, state: State, equations: Linearised, reach: float
) -> tuple[NearPoints, Floats, Floats, list[Bools]]:
    """Return the points that touch or may do so if gaps change by up to ``reach``, m.

    After them come W of eq. CT.14, m^2, G, shape (points, unknowns), and the mask of the points of each pair.
    """
    rows, gradients, close = list[tuple[Floats, ...]](), [np.zeros((0, model.numbering.unknowns))], list[Bools]()
    for pair, touch, multiplier, blur in zip(
        model.pairs, equations.touches, state.multipliers, model.compute_blurs(state), strict=True
    ):
        penalty = state.penalty_fraction * pair.penalty
        trial = multiplier - penalty * touch.gap
        close.append(trial > -penalty * (reach + blur))
        ones = np.ones(np.count_nonzero(close[-1]))
        rows.append((trial[close[-1]], penalty * ones, penalty * blur * ones, pair.weights[close[-1]]))
        if len(ones):
            gradients.append(_spread_gradients(model, *touch.feet.select_points(close[-1]).list_gradients(model.lift.shape[1])))
    trials, penalties, blurs, weights = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    return NearPoints(trials, penalties, blurs), weights, np.concatenate(gradients), close


def _spread_gradients(model: ContactModel, index: Ints, gradients: Floats) -> Floats:
    """Return derivatives with respect to the unknowns, (j, unknowns), from those of ``Footpoints.list_gradients``."""
    unknowns, signs = model.assembly.value_unknowns
    out = np.zeros((len(index), model.numbering.unknowns + 1))  # the last column is of fixed values, number -1
    np.add.at(out, (np.arange(len(index))[:, None], unknowns[index]), signs[index] * gradients)
    return out[:, :-1]


def _solve_surplus(points: NearPoints, opening: Floats, compliance: Floats) -> Floats | None:
    """Solve eq. CT.14 for q of k points, whose gaps change by ``opening`` + ``compliance`` q; None where nothing is found.

    The shapes of the two are (k,) and (k, k).
    """
    q = np.zeros(len(opening))
    surplus, slope = points.compute_surplus(opening)
    error = surplus - q
    tolerance = TOLERANCE_RELATIVE * float(np.abs(error).max())
    for _ in range(MAX_STEPS):
        if np.abs(error).max() <= tolerance:
            return q
        change = np.linalg.solve(np.eye(len(q)) - slope[:, None] * compliance, error)
        for fraction in 0.5 ** np.arange(MAX_HALVINGS):
            trial = q + fraction * change
            surplus, slope = points.compute_surplus(opening + compliance @ trial)
            if np.linalg.norm(surplus - trial) < np.linalg.norm(error):
                break
        q, error = trial, surplus - trial
    return None
