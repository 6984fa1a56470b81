"""A deformed section, and the equations about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from geometry.common.arrays import Bools, Floats
from solver.contact.elements import Balance, ElementValues, Elimination
from solver.contact.touch import Grip, Touch
from solver.linalg.cholesky import Factor


@dataclass(frozen=True)
class State:
    """A deformed section.

    Attributes:
        indentation: of the base, m.
        v: unknowns on corners and edges, shape (unknowns,).
        elements: all values.
        multipliers: of each pair's points, Pa.
        grips: what these remember of the load before, where there is friction.
        share, blur: of the pairs' penalties that is used, and rounding of the contact's kink, in contact lengths.
    """

    indentation: float
    v: Floats
    elements: ElementValues
    multipliers: tuple[Floats, ...]
    grips: tuple[Grip | None, ...]
    share: float = 1.0
    blur: float = 0.0

    @property
    def touching(self) -> Bools:
        """Which points of all pairs touch, as multipliers say."""
        return np.concatenate([multiplier > 0 for multiplier in self.multipliers])


@dataclass(frozen=True)
class WorkingForces:
    """What works in a state.

    Attributes:
        balance: of the elements.
        touches: of the pairs.
        contact: forces of all pairs on the elements' own values, N, shape (n (8 p),).
        residual: forces out of balance, N, shape (unknowns,).
        scale: of the forces that balance, N.
        deepest: by how much lines penetrate each other at most, or part where they are tied, in contact lengths.
    """

    balance: Balance
    touches: tuple[Touch, ...]
    contact: Floats
    residual: Floats
    scale: float
    deepest: float

    @property
    def touched(self) -> bool:
        """Whether there is contact anywhere."""
        return any(np.any(one.pressure > 0) for one in self.touches)

    @property
    def torn(self) -> bool:
        """Whether friction is not yet what it will be, see ``Touch``."""
        return any(one.torn for one in self.touches)

    @property
    def unbalanced(self) -> float:
        """Residual relative to the forces."""
        return float(np.linalg.norm(self.residual)) / self.scale if self.scale > 0 else 0.0


@dataclass(frozen=True)
class Linearised(WorkingForces):
    """The equations about a state.

    Attributes:
        elimination, stiffness: the elements' tangent, of this state or of one next to it, from which a last step led here.
        contact_stiffness: likewise of the pairs, sparse; None where nothing touches.
        factor: of the tangent, where it is known.
    """

    elimination: Elimination
    stiffness: Floats
    contact_stiffness: sp.csr_array | None
    factor: Factor | None = None


def weighted(weights: Sequence[float], states: Sequence[State]) -> State:
    """Weighted sum of states, or of states and what they change by; all else is the first's."""
    both = list(zip(weights, states, strict=True))
    u, p = (np.asarray(sum(w * getattr(state.elements, key) for w, state in both)) for key in ("u", "p"))
    each = zip(*(state.multipliers for state in states), strict=True)
    multipliers = tuple(np.asarray(sum(w * m for w, m in zip(weights, one, strict=True))) for one in each)
    v = np.asarray(sum(w * state.v for w, state in both))
    return replace(states[0], v=v, elements=ElementValues(u, p), multipliers=multipliers)


def lagrange(places: Sequence[float], wanted: float) -> list[float]:
    """Weights of values at places in the polynomial through them."""
    return [float(np.prod([(wanted - other) / (one - other) for other in places if other != one])) for one in places]


def hermite(places: Sequence[float], wanted: float) -> list[float]:
    """Weights of values at places, then of slopes there, in the polynomial through both."""
    squared = [w**2 for w in lagrange(places, wanted)]
    rises = [sum(1 / (one - other) for other in places if other != one) for one in places]
    values = [w * (1 - 2 * rise * (wanted - one)) for one, w, rise in zip(places, squared, rises, strict=True)]
    return [*values, *(w * (wanted - one) for one, w in zip(places, squared, strict=True))]
