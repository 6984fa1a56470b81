"""A deformed section, and the equations about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from solver.contact.elements import ElementValues, Tangent
from solver.contact.touch import Grip, Touch


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


@dataclass(frozen=True)
class Linearised:
    """The equations about a state.

    Attributes:
        tangent: of the elements.
        touches: of the pairs.
        residual: forces out of balance, N, shape (unknowns,).
        scale: of the forces that balance, N.
        deepest: by how much lines penetrate each other at most, or part where they are tied, in contact lengths.
    """

    tangent: Tangent
    touches: tuple[Touch, ...]
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
