"""A deformed section, and the equations about it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

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
        contact: forces of all pairs on the elements' own values, N, shape (n (8 p),).
        residual: forces out of balance, N, shape (unknowns,).
        scale: of the forces that balance, N.
        deepest: by how much lines penetrate each other at most, or part where they are tied, in contact lengths.
    """

    tangent: Tangent
    touches: tuple[Touch, ...]
    contact: Floats
    residual: Floats
    scale: float
    deepest: float

    @cached_property
    def contact_stiffness(self) -> sp.csr_array | None:
        """Of ``contact``; None where nothing touches."""
        parts = [one.stiffness for one in self.touches if one.stiffness.nnz]
        return sum(parts[1:], parts[0]) if parts else None

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
