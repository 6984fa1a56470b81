"""Define the state of a deformed section, the equations about it, and the results at one point of a load path."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from geometry.common.arrays import Floats
from geometry.common.errors import SolveError
from solver.contact.contact_forces import Grip, Touch
from solver.contact.elements import Balance, ElementValues, Elimination
from solver.linalg.cholesky import Factor


@dataclass(frozen=True)
class State:
    """A deformed section.

    Attributes
    ----------
    indentation
        Indentation of the base, m.
    v
        Unknowns on corners and edges, shape (unknowns,).
    elements
        Values of all elements.
    multipliers
        Contact multipliers at each pair's points, Pa.
    grips
        Friction history of each pair since the load before; None without friction.
    penalty_fraction
        Fraction of the pairs' penalties that is used.
    blur
        Rounding of the contact's kink, in contact lengths.
    expected
        Pressures at each pair's points that a step of Newton's method led to, Pa, for the tangent; see ``newton.py``.
    """

    indentation: float
    v: Floats
    elements: ElementValues
    multipliers: tuple[Floats, ...]
    grips: tuple[Grip | None, ...]
    penalty_fraction: float = 1.0
    blur: float = 0.0
    expected: tuple[Floats, ...] | None = None


@dataclass(frozen=True)
class Linearised:
    """The forces in a state, and the equations about it.

    Attributes
    ----------
    balance
        Forces of the elements.
    touches
        Forces of the pairs.
    contact
        Forces of all pairs on the elements' values, N, shape (n (8 p),).
    residual
        Forces out of balance, N, shape (unknowns,).
    scale
        Norm of the forces that balance, N.
    deepest
        Maximum penetration of lines, or separation where they are tied, in contact lengths.
    elimination, stiffness
        The elements' tangent: what was eliminated, and the stiffness on corners and edges, N/m, shape (n, 8 p, 8 p).
    contact_stiffness
        The pairs' tangent, sparse; None where nothing touches.
    factor
        Factorisation of the tangent, or None.
    """

    balance: Balance
    touches: tuple[Touch, ...]
    contact: Floats
    residual: Floats
    scale: float
    deepest: float
    elimination: Elimination
    stiffness: Floats
    contact_stiffness: sp.coo_array | None
    factor: Factor | None = None

    @property
    def has_contact(self) -> bool:
        """Whether any points touch."""
        return any(np.any(touch.pressure > 0) for touch in self.touches)

    @property
    def has_sliding_reversal(self) -> bool:
        """Whether any sliding point has reversed its direction, so that friction has not settled; see ``Touch``."""
        return any(touch.sliding_reversed for touch in self.touches)

    @property
    def relative_residual(self) -> float:
        """Norm of the residual relative to that of the forces."""
        return float(np.linalg.norm(self.residual)) / self.scale if self.scale > 0 else 0.0


@dataclass(frozen=True)
class Equilibrium:
    """A state in equilibrium.

    Attributes
    ----------
    state
        The state.
    equations
        The equations about it.
    residuals
        Relative residual after each Newton step, of all rounds in order.
    """

    state: State
    equations: Linearised
    residuals: tuple[float, ...]

    def store_pressures(self) -> State:
        """Return the state with the contact pressures as its multipliers, as the start of further loads."""
        return replace(self.state, multipliers=tuple(touch.pressure for touch in self.equations.touches))


@dataclass(frozen=True)
class Outputs:
    """Forces on the inner and the outer film, N, or the films' charges, C, at one point of a load path.

    Attributes
    ----------
    values
        The forces or charges, shape (2,).
    tangent
        Their derivatives with respect to indentation, per m, shape (2,).
    log_sensitivities
        d ln value / d ln E of the target, at constant force on the base, shape (2,); 0 without a target.
    """

    values: Floats
    tangent: Floats
    log_sensitivities: Floats

    @property
    def log_sensitivity(self) -> float:
        """Log-sensitivity of the ratio of both values, at constant force; 0 without a target."""
        return float(self.log_sensitivities[0] - self.log_sensitivities[1])


@dataclass(frozen=True)
class PathPoint:
    """Results at one point of a load path.

    Attributes
    ----------
    indentation
        Indentation of the base, m.
    forces
        Forces on both films.
    charges
        Charges of both films; None where they are not modelled.
    walls
        Minimum distance of the gap's walls, m; 0 where they touch.
    contact_radius
        Outer radius of the contact with the tissue, m.
    strain
        Maximum |lambda - 1| of the principal stretches lambda.
    residual
        Relative residual of the equilibrium.
    equilibrium
        The state and its equations.
    rates
        Derivative of the state with respect to indentation.
    """

    indentation: float
    forces: Outputs
    charges: Outputs | None
    walls: float
    contact_radius: float
    strain: float
    residual: float
    equilibrium: Equilibrium
    rates: State

    @property
    def films(self) -> Floats:
        """Forces on both films, N, shape (2,)."""
        return self.forces.values

    @property
    def tangent(self) -> Floats:
        """Derivatives of the film forces with respect to indentation, N/m, shape (2,)."""
        return self.forces.tangent

    @property
    def log_sensitivity(self) -> float:
        """Log-sensitivity of the ratio of the film forces, at constant force; 0 without a target."""
        return self.forces.log_sensitivity

    @property
    def force(self) -> float:
        """Force on the base, N."""
        return float(self.films.sum())

    def advance(self, distance: float) -> PathPoint:
        """Return the results at an indentation deeper by a small ``distance``, m, along the tangent."""
        moved = self._change_values(lambda outputs: outputs.values + distance * outputs.tangent)
        return replace(moved, indentation=self.indentation + distance)

    def scale(self, indentation: float) -> PathPoint:
        """Return the results at another indentation, m, at which forces and charges are proportional to it."""
        factor = indentation / self.indentation
        return replace(self._change_values(lambda outputs: factor * outputs.values), indentation=indentation)

    def release(self) -> PathPoint:
        """Return the results at rest, from those under a load so light that all is linear."""
        return replace(self._change_values(lambda outputs: np.zeros(2)), indentation=0.0)

    def _change_values(self, compute: Callable[[Outputs], Floats]) -> PathPoint:
        """Return the results with other forces and charges, whose derivatives remain."""
        charges = None if self.charges is None else replace(self.charges, values=compute(self.charges))
        return replace(self, forces=replace(self.forces, values=compute(self.forces)), charges=charges)


class StoppedError(SolveError):
    """No further step converges.

    Attributes
    ----------
    last
        The deepest point computed.
    reason
        Why no further step converges.
    """

    def __init__(self, last: PathPoint, reason: str) -> None:
        self.last, self.reason = last, reason
        super().__init__(f"beyond {1e3 * last.indentation:.3g} mm, {last.force:.3g} N, {reason}")


def add_weighted(weights: Sequence[float], states: Sequence[State]) -> State:
    """Return the weighted sum of states, or of states and their rates; all but the sums is copied from the first.

    Unknowns, elements' values and multipliers are summed.
    """
    terms = list(zip(weights, states, strict=True))
    u, p = (np.asarray(sum(w * getattr(state.elements, key) for w, state in terms)) for key in ("u", "p"))
    rows = zip(*(state.multipliers for state in states), strict=True)
    multipliers = tuple(np.asarray(sum(w * m for w, m in zip(weights, row, strict=True))) for row in rows)
    v = np.asarray(sum(w * state.v for w, state in terms))
    return replace(states[0], v=v, elements=ElementValues(u, p), multipliers=multipliers)


def compute_lagrange_weights(places: Sequence[float], wanted: float) -> list[float]:
    """Return the weights with which values at ``places`` sum to their interpolating polynomial at ``wanted`` (Lagrange)."""
    return [
        float(np.prod([(wanted - other_place) / (place - other_place) for other_place in places if other_place != place]))
        for place in places
    ]


def compute_hermite_weights(places: Sequence[float], wanted: float) -> list[float]:
    """Return the weights with which two values, then their derivatives, sum to the cubic through them at ``wanted`` (Hermite)."""
    from scipy.interpolate import CubicHermiteSpline

    order, unit = np.argsort(places), np.eye(4)
    spline = CubicHermiteSpline(np.take(places, order), unit[:2][order], unit[2:][order])
    return [float(weight) for weight in spline(wanted)]
